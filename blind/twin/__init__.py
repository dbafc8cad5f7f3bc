"""How small a change the twin of a reference finds in real flights: faults put into their logs."""
