"""Which skips `.ci/run` accepts."""

import pytest
import skips


@pytest.mark.parametrize(("reason", "status"), [("Ray is not installed; pip", 0), ("it rained", 1)])
def test_a_skip_for_an_unknown_reason_fails_the_session(pytester, reason, status):
    pytester.makepyfile(f"import pytest\ndef test_a():\n    pytest.skip({reason!r})\n")
    found = pytester.inline_run("-p", "no:cacheprovider", plugins=[skips.SkipsCount()])
    assert found.ret == status


def test_an_expected_failure_is_no_skip(pytester):
    pytester.makepyfile("import pytest\n@pytest.mark.xfail\ndef test_a():\n    assert False\n")
    assert pytester.inline_run(plugins=[skips.SkipsCount()]).ret == 0
