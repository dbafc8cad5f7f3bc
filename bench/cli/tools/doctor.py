"""`bench doctor`: versions, devices, known trouble."""


def doctor() -> int:
    """Show versions and devices, and name combinations that are known to break.

    Exit status 1 if something was found that breaks runs.
    """
    # Before anything imports SciPy, which it looks for.
    from bench.conformance.doctor import doctor as examine

    return examine()
