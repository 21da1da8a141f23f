"""Short tasks travel together, long ones alone, and so far ahead that no worker waits."""

from __future__ import annotations

from types import SimpleNamespace

import cloudpickle
import pytest

from bayescal.experiments.runner.distributed import AHEAD, ANSWER, KILLED, TARGET, Cluster, Feed


class Client:
    """What a feed asks of a client: how many threads there are, and to send batches."""

    def __init__(self, threads: int) -> None:
        self.threads, self.batches = threads, {}

    def nthreads(self) -> dict[str, int]:
        return {"worker": self.threads} if self.threads else {}

    def map(self, work, packed, key, parcel, pure):
        self.batches |= {one: cloudpickle.loads(batch) for one, batch in zip(key, packed, strict=True)}
        return [SimpleNamespace(key=one) for one in key]


def start(n_tasks, threads=2):
    client = Client(threads)
    return client, Feed(client, len, "run", None, {str(k): k for k in range(n_tasks)})


def finish(feed, client, seconds_each):
    """End all batches under way; return their sizes."""
    keys = list(feed.sent)
    for key in keys:
        feed.end(key, seconds_each * len(client.batches[key]))
    return [len(client.batches[key]) for key in keys]


@pytest.mark.parametrize(("seconds", "size"), [(2.0 * TARGET, 1), (TARGET / 10.0, 10), (1e-9, 323)])
def test_batches_are_as_large_as_tasks_are_short(seconds, size):
    client, feed = start(1944)
    feed.fill()
    assert finish(feed, client, seconds) == [1] * (2 * AHEAD)
    feed.fill()
    assert max(finish(feed, client, seconds)) == size


@pytest.mark.parametrize("threads", [0, 1, 5])
def test_every_task_is_sent_once(threads):
    client, feed = start(100, threads)
    rounds = 0
    while not feed.is_done:
        feed.fill()
        finish(feed, client, 0.1)
        rounds += 1
    assert sorted(task for batch in client.batches.values() for task in batch) == list(range(100))
    assert rounds < 40
    assert feed.fill() == []


def test_tasks_of_a_batch_that_killed_workers_are_tried_alone():
    client, feed = start(40, 1)
    feed.fill()
    finish(feed, client, TARGET / 4.0)
    key = feed.fill()[0].key
    names = feed.sent[key][1]
    assert len(names) > 1
    cluster = Cluster(client, "tcp://there", own=False)
    assert list(cluster._sort(feed, key, (ValueError, f"{KILLED} 2 workers"))) == []
    finish(feed, client, TARGET / 4.0)
    alone = [one.key for one in feed.fill()]
    assert [feed.sent[one][1] for one in alone] == [(name,) for name in names[: len(alone)]]
    (found,) = cluster._sort(feed, alone[0], (ValueError, f"{KILLED} 2 workers"))
    assert found == (names[0], (ValueError, f"{KILLED} 2 workers"))
    assert list(cluster._sort(feed, alone[1], (ANSWER, 0.1, [{"a": 1}]))) == [(names[1], {"a": 1})]
