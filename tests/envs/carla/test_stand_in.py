"""The stand-in offers nothing that the real client package has not."""

from __future__ import annotations

import pytest

carla = pytest.importorskip("carla")

OURS = {
    "Client": set(),
    "World": {"actors", "frame"},
    "Manager": {"synchronous", "seed", "ignoring"},
    "Library": set(),
    "Blueprint": {"attributes"},
    "Actor": {
        *("move", "push", "touches", "numbers", "solid", "physics", "autopilot", "callback"),
        *("started", "stopped"),
    },
}
"""What the tests look at, and what a server does behind the client's back."""
REAL = {
    "Client": ["Client"],
    "World": ["World"],
    "Manager": ["TrafficManager"],
    "Library": ["BlueprintLibrary"],
    "Blueprint": ["ActorBlueprint"],
    "Actor": ["Vehicle", "Walker", "WalkerAIController", "ServerSideSensor"],
}


@pytest.mark.parametrize("name", sorted(OURS))
def test_every_name_is_one_of_the_client_package(name):
    from . import stand_in

    offered = {entry for entry in dir(getattr(stand_in, name)) if not entry.startswith("_")}
    real = {entry for kind in REAL[name] for entry in dir(getattr(carla, kind))}
    assert len(offered - OURS[name]) > 1
    assert offered - OURS[name] <= real


def test_attributes_are_read_as_from_the_client_package(server):
    blueprint = server.world.get_blueprint_library().find("vehicle.audi.a2")
    assert {entry for entry in vars(blueprint.get_attribute("base_type"))} <= set(
        dir(carla.ActorAttribute)
    )
    world = server.world
    actor = world.try_spawn_actor(blueprint, carla.Transform())
    named = {"id", "type_id", "bounding_box", "parent", "is_alive", "attributes"}
    assert named <= set(vars(actor))
    assert named <= set(dir(carla.Vehicle))
    assert {"frame", "other_actor"} <= set(dir(carla.CollisionEvent))


def test_settings_are_copies_and_dead_actors_are_refused(server):
    """As from a server: without this, nothing would tell whether anything is put back."""
    settings = server.world.get_settings()
    settings.synchronous_mode = True
    assert not server.world.get_settings().synchronous_mode
    blueprint = server.world.get_blueprint_library().find("vehicle.audi.a2")
    actor = server.world.try_spawn_actor(blueprint, carla.Transform())
    assert server.world.try_spawn_actor(blueprint, carla.Transform()) is None
    actor.destroy()
    with pytest.raises(RuntimeError, match="destroyed actor"):
        actor.get_transform()
