"""What `make test` leaves out, and which skips `.ci/run` accepts."""

import exhaustive
import pytest
import skips


class Item:
    """A collected test, as far as the rules look at it."""

    def __init__(self, path, case):
        self.path, self.module, self.marks = path, type("module", (), {"test_a": 1}), []
        self.originalname = "test_a"
        self.callspec = type("callspec", (), {"id": case})

    def add_marker(self, mark):
        self.marks.append(mark.name)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "tests" / "some" / "test_file.py"


def test_a_rule_marks_its_cases_and_no_others(monkeypatch, file):
    monkeypatch.setattr(
        exhaustive, "RULES", (exhaustive.Rule("some/test_file.py", "test_a", "b-", ""),)
    )
    items = [Item(file, "b-1"), Item(file, "ab-1"), Item(file.with_name("test_other.py"), "b-1")]
    exhaustive.mark(items)
    assert [item.marks for item in items] == [["exhaustive"], [], []]


def test_a_rule_of_a_test_that_is_gone_is_an_error(monkeypatch, file):
    monkeypatch.setattr(
        exhaustive, "RULES", (exhaustive.Rule("some/test_file.py", "test_b", "", ""),)
    )
    with pytest.raises(pytest.UsageError, match=r"names test_b, which tests/some/test_file.py"):
        exhaustive.mark([Item(file, "b-1")])


@pytest.mark.parametrize(("reason", "status"), [("Ray is not installed; pip", 0), ("it rained", 1)])
def test_a_skip_for_an_unknown_reason_fails_the_session(pytester, reason, status):
    pytester.makepyfile(f"import pytest\ndef test_a():\n    pytest.skip({reason!r})\n")
    found = pytester.inline_run("-p", "no:cacheprovider", plugins=[skips.SkipsCount()])
    assert found.ret == status


def test_an_expected_failure_is_no_skip(pytester):
    pytester.makepyfile("import pytest\n@pytest.mark.xfail\ndef test_a():\n    assert False\n")
    assert pytester.inline_run(plugins=[skips.SkipsCount()]).ret == 0
