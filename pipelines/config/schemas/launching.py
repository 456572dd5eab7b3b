"""Where a study's or an audit's work is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tossid.settings.kinds import Count, Positive


@dataclass(frozen=True)
class ProcessesLauncher:
    """Processes of this machine, one a core by default."""

    name: Literal["processes"]
    """processes"""


@dataclass(frozen=True)
class DaskLauncher:
    """The workers of a Dask scheduler that runs already; they see this machine's files under the same paths."""

    name: Literal["dask"]
    """a Dask scheduler"""
    address: str
    """the scheduler's address: tls://HOST:PORT, or tcp://HOST:PORT on this machine"""
    tls: Path | None
    """folder of cert.pem and key.pem, which the scheduler and its workers have too; null: as Dask's own configuration
    says"""
    insecure: bool
    """take a scheduler on another machine without TLS: whoever reaches its port can then run code as you"""
    wait_s: Positive
    """how long to wait for the scheduler and its first worker [s]"""


@dataclass(frozen=True)
class SlurmLauncher:
    """Jobs of a Slurm cluster, each a Dask worker with one core; started here and ended with the command."""

    name: Literal["slurm"]
    """Slurm jobs"""
    jobs: Count
    """how many"""
    queue: str | None
    """partition; null: the cluster's default"""
    account: str | None
    """account; null: the user's default"""
    memory: str
    """memory of a job"""
    walltime: str
    """longest time of a job, HH:MM:SS"""
    interface: str
    """network interface that jobs reach this machine by ("ib0"); the command listens there and nowhere else"""
    tls: bool
    """encrypt, and take only workers that hold the certificate that the command makes for them"""
    wait_s: Positive
    """how long to wait for the first job to start, and for another once none is left [s]"""


Launcher = ProcessesLauncher | DaskLauncher | SlurmLauncher
