"""What was run: folders of runs, tables of rows, what is still missing."""
