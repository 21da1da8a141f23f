"""Batches in threads: the same results in the same order, in the context of the caller."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from bayescal.numerics.threads import map_in_threads, use_threads


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_results_come_in_the_order_of_the_parts(threads):
    with use_threads(threads):
        assert map_in_threads(lambda part: part**2, list(range(17))) == [k**2 for k in range(17)]


def test_threads_work_side_by_side_and_no_others_within_them():
    both = threading.Barrier(2, timeout=30.0)

    def meet(part):
        both.wait()  # broken where one comes after the other
        return map_in_threads(lambda _: threading.get_ident(), [part] * 5)

    with use_threads(2):
        first, second = map_in_threads(meet, [0, 1])
    assert len(set(first)) == len(set(second)) == 1
    assert first[0] != second[0]


def test_without_a_word_nothing_leaves_this_thread():
    assert set(map_in_threads(lambda _: threading.get_ident(), [0] * 5)) == {threading.get_ident()}
    with use_threads(4):
        pass
    assert set(map_in_threads(lambda _: threading.get_ident(), [0] * 5)) == {threading.get_ident()}


def test_what_numpy_warns_of_is_what_the_caller_says():
    with use_threads(2):
        with np.errstate(divide="ignore"):
            assert np.isinf(map_in_threads(lambda part: np.float64(1.0) / part, list(np.zeros(4)))).all()
        with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
            map_in_threads(lambda part: np.float64(1.0) / part, list(np.zeros(4)))


def test_what_one_raises_is_raised():
    def fail(part):
        if part == 3:
            raise ValueError("three")
        return part

    with use_threads(2), pytest.raises(ValueError, match="three"):
        map_in_threads(fail, list(range(5)))
