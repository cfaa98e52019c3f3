"""`--cluster` beside `--worlds` and `--jobs`: where work is done, checked before anything begins."""

from __future__ import annotations

from wcsim.cli.shared.common import MOST_JOBS, in_bounds, worlds_of
from wcsim.errors import ConfigError
from wcsim.server.workers.crew import WorkerNow
from wcsim.server.workers.machines import Machines


def machines_of(cluster: str, asked: int | None, option: str) -> Machines:
    """The machines that somebody names.

    Args:
        cluster: As typed.
        asked: How many workers; None where nobody said: see `worlds_of`, and nodes of a cluster say it themselves.
        option: What that is called.

    Raises:
        ConfigError: There are none.
    """
    if asked is not None:
        in_bounds(option, asked, 1, MOST_JOBS)
    if not cluster:
        return Machines(count=worlds_of(asked))
    from wcsim.server.workers.cluster.joining import LOCAL
    from wcsim.server.workers.cluster.ray_workers import require_address

    count = worlds_of(asked) if cluster == LOCAL else asked or 1
    if cluster != LOCAL and count > 1:
        raise ConfigError(
            f"{option} {count} and --cluster {cluster}: `ray start --num-cpus` sets the workers of a node "
            f"there; leave one of the two out"
        )
    require_address(cluster)
    return Machines(count=count, cluster=cluster)


def said_of(workers: tuple[WorkerNow, ...]) -> str:
    """Who is at what, in a line.

    >>> said_of((WorkerNow(name="10.0.0.2/1", key="3-000-0001", for_s=12.3), WorkerNow(name="10.0.0.2/2", key="")))
    '10.0.0.2/1 3-000-0001 for 12 s, 10.0.0.2/2 free'
    """
    return ", ".join(f"{each.name} {f'{each.key} for {each.for_s:.0f} s' if each.key else 'free'}" for each in workers)
