"""A static site over everything that was measured: suites, documents and diagnoses."""
