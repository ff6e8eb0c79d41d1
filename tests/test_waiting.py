"""What waits for a worker: nobody who hands it over waits, unless they want to."""

from __future__ import annotations

import threading

from dronemon.waiting import BoundedQueue


def test_whoever_wants_to_waits_until_all_is_taken() -> None:
    queue, may_go_on, taken = BoundedQueue[int](max_items=3), threading.Event(), list[int]()

    def work() -> None:
        for item in queue:
            may_go_on.wait()
            taken.append(item)

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    for item in range(3):
        queue.put(item)
    queue.wait_empty(timeout_s=0.01)  # it is not, and there is a limit
    assert taken == []
    may_go_on.set()
    queue.wait_empty(timeout_s=60.0)
    assert queue.put(3)
    queue.close(timeout_s=60.0)
    worker.join(60.0)
    assert (taken, queue.dropped) == ([0, 1, 2, 3], 0)
