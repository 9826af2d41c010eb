"""Reaching a CARLA server, and telling in one sentence why it cannot be used."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from haim_torchrl.envs.carla.package import carla_package

MakeClient = Callable[[str, int], Any]
"""Makes a client of a host and a port; ``carla.Client`` is one."""


def connect(host: str, port: int, timeout: float, make_client: MakeClient | None = None) -> Any:
    """A client of the server at an address.

    Args:
        host, port: the address.
        timeout: how long each answer may take [s].
        make_client: ``carla.Client`` by default.

    Raises:
        RuntimeError: nobody answers, or a server of another version.
    """
    make_client = make_client or carla_package().Client
    client = make_client(host, port)
    client.set_timeout(timeout)
    wanted = client.get_client_version()
    try:
        found = client.get_server_version()
    except RuntimeError as error:
        raise RuntimeError(
            f"no CARLA server answered at {host}:{port} within {timeout:g} s; start CARLA {wanted} "
            f"there (./CarlaUE4.sh -RenderOffScreen -carla-rpc-port={port}), or set env.host, "
            "env.ports or env.timeout"
        ) from error
    if found != wanted:
        raise RuntimeError(
            f"the CARLA server at {host}:{port} has version {found}, the Python client {wanted}; "
            f"start a server of version {wanted}, or install its client: pip install carla=={found}"
        )
    return client


def check_towns(client: Any, towns: Iterable[str]) -> None:
    """See to it that a server has these towns.

    Raises:
        RuntimeError: it lacks one.
    """
    known = sorted({short_name(name) for name in client.get_available_maps()})
    for town in towns:
        if town not in known:
            raise RuntimeError(
                f"the CARLA server has no town {town}; set env.train_town and env.test_town to two "
                f"of {', '.join(known)}"
            )


def short_name(map_name: str) -> str:
    """A map's name without its folders, such as ``Town01``."""
    return map_name.rsplit("/", 1)[-1]
