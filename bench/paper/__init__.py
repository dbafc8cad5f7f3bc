"""The paper's claims beside ours: a table of rules, one judge, one page."""
