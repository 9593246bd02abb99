"""How far an operation is: what rooms count, and the line that says it."""

import pytest

from pqsec_pki import _processes, _progress
from pqsec_pki._processes import LEAST, shared_out
from pqsec_pki._progress import Stage, counted, current, stage
from pqsec_pki.cli._progress import said


def test_what_is_done_is_counted_until_the_end_and_then_forgotten():
    found = [(item, current().done) for item in counted("abc", 3, "letters")]
    assert found == [("a", 0), ("b", 1), ("c", 2)]
    assert current() is None


def test_an_operation_within_another_counts_for_that_one():
    with stage(10, "changes") as here:
        assert list(counted("abc", 3, "letters")) == ["a", "b", "c"]
        assert current() == Stage(10, "changes", done=3)
        here.reach(5)
        here.reach(4)
        assert here.done == 5
        here.add(20)
        assert here.done == 10


def test_an_operation_that_ends_after_the_one_around_it_leaves_none():
    around, within = counted("ab", 2), counted("ab", 2)
    for _ in zip(around, within, strict=True):
        pass
    within.close()
    assert current() is None


@pytest.fixture(autouse=True)
def no_operation(monkeypatch):
    """Not one of another test either, whose error may still have it."""
    monkeypatch.setattr(_progress._Now, "stage", None)


@pytest.mark.parametrize("cores", [1, 2])
def test_work_that_fails_ends_the_operation_although_its_error_is_kept(monkeypatch, cores):
    monkeypatch.setattr(_processes, "_cores", lambda: cores)
    with pytest.raises(ZeroDivisionError) as caught:
        shared_out(lambda number: 1 // number, range(2 * LEAST))
    assert current() is None
    assert caught.value


def test_a_failure_ends_the_operation():
    with pytest.raises(ValueError, match="here"), stage(1):
        raise ValueError("here")
    assert current() is None


@pytest.mark.parametrize("cores", [1, 2])
def test_work_in_several_processes_is_counted_as_all_of_it(monkeypatch, cores):
    monkeypatch.setattr(_processes, "_cores", lambda: cores)
    seen = []
    shared_out(lambda _: seen.append((current().done, current().total)), range(2 * LEAST))
    ours = 2 * LEAST // cores  # a fork's list is its own
    assert seen == [(number * cores, 2 * LEAST) for number in range(ours)]
    assert current() is None


@pytest.mark.parametrize(
    ("now", "seconds", "line"),
    [
        (None, 1.2, "pqsec try: 1 s"),
        (Stage(1000, done=120), 12.0, "pqsec try: 120 of 1000, 12 s"),
        (Stage(9, "pairs", done=3), 70.0, "pqsec try: 3 of 9 pairs, 70 s"),
    ],
)
def test_the_line_says_how_much_of_what_and_how_long(now, seconds, line):
    assert said("pqsec try", now, seconds) == line
