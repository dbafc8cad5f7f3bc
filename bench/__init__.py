"""The harness: command line, suites, plan, execution, store, statistics, reports."""
