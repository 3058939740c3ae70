"""Many tasks of one kind: one after another, in processes of this machine, or on the workers of a Dask scheduler.

A task is a function of plain values, so that it can go to another process. Its result does not depend on where it
runs. A worker that dies costs its task, which another worker begins again.
"""

import os
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from bayes_greybox.running.errors import InputError

SCHEDULER_LOST = "The Dask scheduler was lost before this was done; start one again, and give it what is left."
"""Failure of tasks that were not done when the scheduler was lost."""


@dataclass(frozen=True)
class Done:
    """Outcome of a task: its name, and its return value or the reason of its failure in one sentence."""

    name: str
    result: Any = None
    failed: str = ""


def run_tasks(
    function: Callable[..., Any],
    tasks: Mapping[str, Sequence[Any]],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Generator[Done, None, None]:
    """Run a function on the arguments of each task, and yield each task once, as soon as it is done.

    One that fails costs itself alone; a lost scheduler costs all that is not done, see `SCHEDULER_LOST`.

    Args:
        function: Function of a module, so that a worker finds it.
        tasks: Its arguments by the name of the task.
        workers: Processes of this machine; by default as many as it has cores, where Dask is there, else one. With one
            tasks run here, one after another.
        scheduler: Address of a Dask scheduler, such as "tcp://host:8786", whose workers have this package.

    Raises:
        InputError: There is no Dask, or no scheduler answers; workers beside a scheduler; arguments that cannot be sent
            to another process.
    """
    if scheduler is not None and workers is not None:
        raise InputError("A scheduler has workers of its own: give --scheduler or --workers, not both.")
    if scheduler is None and workers is None:
        workers = 1
        with suppress(ImportError):
            import distributed  # noqa: F401

            workers = min(os.cpu_count() or 1, len(tasks))
    if scheduler is None and (workers == 1 or len(tasks) < 2):
        for name, arguments in tasks.items():
            yield _done(name, lambda arguments=arguments: function(*arguments))
        return
    with ExitStack() as stack:
        client, as_completed = _client(stack, workers, scheduler)
        try:
            futures = {
                # A scheduler serves others too: under a common key it would return the result of another's task.
                client.submit(function, *arguments, key=f"{name}-{uuid4().hex}", pure=False): name
                for name, arguments in tasks.items()
            }
        except TypeError as error:
            raise InputError(
                "Workers cannot be sent what they are to do: give functions of a module, which hold no open file, lock "
                "or connection, or leave workers and scheduler out."
            ) from error
        for future in as_completed(futures):
            done = _done(futures[future], future.result)
            # Only a client whose scheduler is gone cancels tasks; results that came before stay valid.
            yield Done(done.name, failed=SCHEDULER_LOST) if done.failed and future.cancelled() else done
            future.release()


def _client(stack: ExitStack, workers: int | None, scheduler: str | None) -> tuple[Any, Any]:
    """Connect to workers until the stack ends; return the client and Dask's `as_completed`."""
    try:
        from dask.config import set as configured
        from distributed import Client, LocalCluster, as_completed
    except ImportError:
        raise InputError(
            'Several workers need Dask: pip install ".[distributed]" in the checkout, or give --workers 1.'
        ) from None

    # A task that kills every worker is itself at fault.
    stack.enter_context(configured({"distributed.scheduler.allowed-failures": 3}))
    place: Any = scheduler
    if scheduler is None:
        # One task at a time in each process: a study has threads of its own. Memory is the machine's to watch.
        options = {"threads_per_worker": 1, "processes": True, "memory_limit": 0, "silence_logs": 50}
        cluster = LocalCluster(n_workers=workers, dashboard_address="127.0.0.1:0", **options)
        place = stack.enter_context(cluster)
    try:
        client = stack.enter_context(Client(place, timeout=5))
        if scheduler is not None:
            client.wait_for_workers(1, timeout=20)
    except TimeoutError:
        raise InputError(f"The Dask scheduler at {scheduler!r} has no workers; start some with dask worker.") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"No Dask scheduler answers at {scheduler!r} ({error}); start one with dask scheduler."
        ) from None
    return client, as_completed


def _done(name: str, result: Callable[[], Any]) -> Done:
    try:
        return Done(name, result())
    except InputError as error:
        return Done(name, failed=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, the other tasks go on
        return Done(name, failed=f"{type(error).__name__}: {error}")
