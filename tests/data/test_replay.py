"""The replay: who goes where, what a batch is made of, what a restart keeps."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from haim_torchrl.data import TakeoverReplayBuffer, make_replay_buffer


def transitions(*flags: bool, first: int = 0, size: int = 3) -> TensorDict:
    """One transition per flag; all numbers of the i-th are first + i."""
    count = len(flags)
    number = torch.arange(first, first + count, dtype=torch.float32).unsqueeze(-1)
    return TensorDict(
        {
            "observation": number.expand(count, size).clone(),
            "action": number.expand(count, 2).clone(),
            "intervention": torch.tensor(flags, dtype=torch.bool).reshape(count, 1),
            "next": {
                "observation": number.expand(count, size) + 0.5,
                "terminated": torch.zeros(count, 1, dtype=torch.bool),
                "reward": number.clone(),
            },
        },
        batch_size=[count],
    )


def filled(mentor: int, free: int, **options: object) -> TakeoverReplayBuffer:
    replay = make_replay_buffer(1000, **options)
    replay.extend(transitions(*[True] * mentor, *[False] * free))
    return replay


def test_transitions_are_routed_by_who_drove() -> None:
    replay = make_replay_buffer(10)
    replay.extend(transitions(True, False, True, False, False))
    assert (len(replay.intervened), len(replay.free), len(replay)) == (2, 3, 5)
    assert replay.intervened.columns()["action"][:, 0].tolist() == [0.0, 2.0]
    assert replay.free.columns()["action"][:, 0].tolist() == [1.0, 3.0, 4.0]


@settings(max_examples=50, deadline=None)
@given(
    mentor=st.integers(0, 40),
    free=st.integers(0, 40),
    size=st.integers(1, 64),
    share=st.sampled_from([0.25, 0.5, 0.75]),
)
def test_a_balanced_batch_has_its_share_of_each_kind_while_both_exist(
    mentor: int, free: int, size: int, share: float
) -> None:
    replay = filled(mentor, free, share=share)
    if not mentor + free:
        with pytest.raises(RuntimeError, match="empty"):
            replay.sample(size)
        return
    batch = replay.sample(size)
    assert batch.batch_size == (size,)
    expected = size if not free else 0 if not mentor else int(size * share)
    assert batch["intervention"].sum() == expected
    # Rows belong together: all entries of a row come from one transition.
    number = batch["action"][:, :1]
    torch.testing.assert_close(batch["observation"], number.expand(size, 3))
    torch.testing.assert_close(batch["next", "observation"], number.expand(size, 3) + 0.5)
    torch.testing.assert_close(batch["intervention"], number < mentor)


@settings(max_examples=20, deadline=None)
@given(mentor=st.integers(0, 30), free=st.integers(1, 30))
def test_a_uniform_batch_follows_the_numbers(mentor: int, free: int) -> None:
    torch.manual_seed(0)
    replay = filled(mentor, free, sampling="uniform")
    batch = replay.sample(4000)
    share = batch["intervention"].float().mean().item()
    assert share == pytest.approx(mentor / (mentor + free), abs=0.05)
    torch.testing.assert_close(batch["intervention"], batch["action"][:, :1] < mentor)
    drawn = batch["action"][:, 0].unique()
    assert len(drawn) == mentor + free  # everything comes up


def test_every_stored_transition_can_be_drawn() -> None:
    torch.manual_seed(0)
    drawn = filled(7, 5).sample(500)["action"][:, 0].unique()
    assert drawn.tolist() == list(range(12))


def test_the_same_seed_gives_the_same_batches() -> None:
    replay = filled(20, 20)
    torch.manual_seed(3)
    first = replay.sample()
    torch.manual_seed(3)
    assert (replay.sample() == first).all()
    assert not (replay.sample() == first).all()


def test_the_oldest_give_way() -> None:
    replay = make_replay_buffer(4, mentor_capacity=2)
    for start in range(0, 6, 2):
        replay.extend(transitions(False, False, first=start))
    replay.extend(transitions(True, True, True, first=10))
    assert sorted(replay.free.columns()["action"][:, 0].tolist()) == [2.0, 3.0, 4.0, 5.0]
    assert sorted(replay.intervened.columns()["action"][:, 0].tolist()) == [11.0, 12.0]


def test_a_batch_of_sequences_is_flattened() -> None:
    replay = make_replay_buffer(100)
    replay.extend(transitions(True, False, False, True).reshape(2, 2))
    assert (len(replay.intervened), len(replay.free)) == (2, 2)


def test_single_transitions_can_be_added() -> None:
    replay = make_replay_buffer(100)
    replay.add(transitions(True)[0])
    replay.add(transitions(False, first=1)[0])
    assert sorted(replay.sample(2)["action"][:, 0].tolist()) == [0.0, 1.0]


def test_only_wanted_entries_are_kept() -> None:
    replay = filled(2, 2)
    assert ("next", "reward") not in replay.sample(2).keys(True, True)
    keys = ["observation", ("next", "reward")]
    replay = filled(2, 2, keys=keys)
    assert set(replay.sample(2).keys(True, True)) == {*keys, "intervention"}


def test_what_is_sampled_is_a_copy() -> None:
    replay = filled(2, 2)
    replay.sample()["observation"].fill_(-1.0)
    assert replay.sample()["observation"].min() >= 0.0


def test_double_precision_is_stored_as_single() -> None:
    replay = make_replay_buffer(10)
    data = transitions(True)
    data["observation"] = data["observation"].double()
    replay.extend(data)
    assert replay.sample(1)["observation"].dtype == torch.float32


def test_memory_is_what_is_stored() -> None:
    replay = make_replay_buffer(1_000_000)
    replay.extend(transitions(True, False))
    # observation and next 3, action 2 numbers of 4 bytes, two flags of 1 byte
    assert replay.nbytes == 2 * ((3 + 3 + 2) * 4 + 2)


@pytest.mark.parametrize("way", ["state_dict", "dumps"])
def test_a_restart_goes_on_as_if_nothing_had_happened(way: str, tmp_path: Path) -> None:
    def make() -> TakeoverReplayBuffer:
        return make_replay_buffer(5, batch_size=16)

    replay = make()
    for start in range(0, 9, 3):
        replay.extend(transitions(True, False, False, first=start))
    restored = make()
    if way == "state_dict":
        restored.load_state_dict(replay.state_dict())
    else:
        replay.dumps(tmp_path / "buffer")
        restored.loads(tmp_path / "buffer")
    for each in (replay, restored):
        each.extend(transitions(False, True, first=100))
    assert len(restored) == len(replay) == 9
    torch.manual_seed(0)
    expected = replay.sample()
    torch.manual_seed(0)
    assert (restored.sample() == expected).all()


def test_a_saved_state_does_not_change_afterwards() -> None:
    replay = make_replay_buffer(2)
    replay.extend(transitions(False, False))
    state = replay.state_dict()
    replay.extend(transitions(False, False, first=50))
    replay.load_state_dict(state)
    assert sorted(replay.free.columns()["action"][:, 0].tolist()) == [0.0, 1.0]


def test_an_empty_replay_can_be_saved_and_restored() -> None:
    replay = make_replay_buffer(5)
    replay.load_state_dict(make_replay_buffer(5).state_dict())
    replay.extend(transitions(True))
    assert len(replay) == 1


def test_it_can_be_emptied() -> None:
    replay = filled(2, 2)
    replay.empty()
    assert len(replay) == 0 and replay.nbytes == 0
    replay.extend(transitions(True, size=7))
    assert replay.sample(1)["observation"].shape == (1, 7)


def test_a_state_of_another_capacity_is_refused() -> None:
    with pytest.raises(ValueError, match="same capacity"):
        make_replay_buffer(5).load_state_dict(make_replay_buffer(6).state_dict())


def test_a_folder_without_a_replay_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no replay"):
        make_replay_buffer(5).loads(tmp_path)


def test_missing_and_misshapen_entries_are_named() -> None:
    with pytest.raises(KeyError, match="takeover_cost"):
        filled(1, 1, keys=[("next", "takeover_cost")])
    with pytest.raises(KeyError, match="intervention"):
        make_replay_buffer(5).extend(transitions(True).exclude("intervention"))
    with pytest.raises(ValueError, match=r"'observation' has shape \(4,\).*\(3,\)"):
        filled(1, 1).extend(transitions(True, size=4))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"capacity": 0}, "capacity"),
        ({"batch_size": 0}, "batch_size"),
        ({"sampling": "fair"}, "'fair'"),
        ({"share": 1.0}, "share"),
        ({"mentor_capacity": 0}, "capacity"),
    ],
)
def test_bad_settings_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_replay_buffer(**{"capacity": 10, **options})


def test_images_stay_bytes_in_the_store_and_in_a_batch() -> None:
    """A transition takes two images of 2 * 4 * 4 bytes, a flag, and two floats of the action."""
    replay = make_replay_buffer(100, batch_size=6, keys=["pixels", ("next", "pixels"), "action"])
    pixels = torch.arange(4, dtype=torch.uint8).reshape(4, 1, 1, 1).expand(4, 2, 4, 4)
    flags = torch.tensor([[True], [False], [False], [True]])
    actions = pixels[:, 0, 0, :2].float()
    data = {"pixels": pixels, "action": actions, "intervention": flags}
    replay.extend(TensorDict({**data, "next": {"pixels": pixels + 100}}, batch_size=[4]))
    assert replay.nbytes == 4 * (2 * 2 * 4 * 4 + 1 + 2 * 4)
    batch = replay.sample()
    assert batch["pixels"].dtype == batch["next", "pixels"].dtype == torch.uint8
    assert batch["pixels"].shape == (6, 2, 4, 4)
    numbers = batch["pixels"][:, 0, 0, 0]
    assert (batch["pixels"] == numbers.reshape(6, 1, 1, 1)).all()
    assert (batch["next", "pixels"] == batch["pixels"] + 100).all()
    assert torch.equal(batch["action"][:, 0], numbers.float())
    again = make_replay_buffer(100)
    again.load_state_dict(replay.state_dict())
    assert again.sample(2)["pixels"].dtype == torch.uint8


def test_where_nobody_takes_over_all_transitions_are_of_one_kind() -> None:
    replay = make_replay_buffer(100, 4, keys=["observation"], intervention_key=None)
    replay.extend(TensorDict(observation=torch.arange(6.0).reshape(2, 3, 1), batch_size=[2, 3]))
    assert len(replay) == len(replay.free) == 6 and len(replay.intervened) == 0
    drawn = replay.sample(200)
    assert set(drawn.keys(True, True)) == {"observation"}
    assert set(drawn["observation"].flatten().tolist()) == set(range(6))
    copy = make_replay_buffer(100, 4, keys=["observation"], intervention_key=None)
    copy.load_state_dict(replay.state_dict())
    assert len(copy) == 6
