"""Who drives which server: one simulator at a time, across simulators and processes.

A CARLA server has one world and one clock. Two simulators that tick it would both see time run
twice as fast, and nothing would say so.
"""

from __future__ import annotations

import fcntl
import tempfile
from pathlib import Path
from typing import IO

from haim_torchrl.envs.carla.client import MakeClient, connect
from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.session import Session


class _Server:
    """A server that this process has to itself.

    Attributes:
        lock: file that is locked for as long; the lock goes with the process.
        seats: how many simulators of this process use it.
        session: who drives it now.
    """

    def __init__(self, lock: IO[str]) -> None:
        self.lock = lock
        self.seats = 0
        self.session: Session | None = None


_servers: dict[tuple[str, int], _Server] = {}


class Seat:
    """A simulator's place at a server.

    Several servers may be named: each simulator takes one that nobody drives, or else shares one
    with another simulator of its process. Those that share take turns: who begins an episode ends
    the other's.

    Args:
        config: where servers are.
        make_client: ``carla.Client`` by default.
    """

    def __init__(self, config: CarlaConfig, make_client: MakeClient | None = None) -> None:
        self._config, self._make_client = config, make_client
        self._address: tuple[str, int] | None = None
        self._session: Session | None = None

    @property
    def session(self) -> Session | None:
        """The session of this seat; None when there is none, or another seat took over."""
        return self._session if self._session is not None and not self._session.closed else None

    def take(self) -> Session:
        """Drive a server, the same as before if there was one.

        Raises:
            RuntimeError: other processes drive all of them, or nobody answers.
        """
        if self.session is not None:
            return self.session
        if self._address is None:
            self._address = _claim(self._config.host, self._config.ports)
        server, (host, port) = _servers[self._address], self._address
        if server.session is not None:
            server.session.close()
        client = connect(host, port, self._config.timeout, self._make_client)
        self._session = Session(client, port, self._config.timeout, self._config.rendering)
        server.session = self._session
        return self._session

    def close(self) -> None:
        """Put everything back and leave the server to others; a second call changes nothing."""
        if self._session is not None:
            self._session.close()
            self._session = None
        if self._address is not None:
            address, self._address = self._address, None
            server = _servers[address]
            server.seats -= 1
            if not server.seats:
                del _servers[address]
                server.lock.close()


def _claim(host: str, ports: tuple[int, ...]) -> tuple[str, int]:
    """An address that nobody drives, or the least used of this process."""
    for port in ports:
        if (host, port) not in _servers and (lock := _lock(host, port)) is not None:
            _servers[host, port] = _Server(lock)
            break
    ours = [(host, port) for port in ports if (host, port) in _servers]
    if not ours:
        raise RuntimeError(
            f"other processes drive every CARLA server of env.ports ({list(ports)}) at {host}; "
            f"start one more and name its port, too: env.ports=[{ports[0]},{ports[-1] + 4}]"
        )
    address = min(ours, key=lambda address: _servers[address].seats)
    _servers[address].seats += 1
    return address


def _lock(host: str, port: int) -> IO[str] | None:
    """The locked file of an address; None if another process has locked it."""
    name = "".join(c if c.isalnum() else "_" for c in f"{host}_{port}")
    path = Path(tempfile.gettempdir()) / f"haim_torchrl_carla_{name}.lock"
    file = path.open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file
