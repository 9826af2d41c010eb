"""Left and right exchanged."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.data import Reflection, TakeoverReplayBuffer

#: Speed, offset to the right, room on the left, room on the right; pedal and wheel.
ROAD = Reflection(order=(0, 1, 3, 2), sign=(1.0, -1.0, 1.0, 1.0), action_sign=(1.0, -1.0))


def transition(count: int = 1) -> TensorDict:
    data = {
        "observation": torch.tensor([7.0, 0.5, 2.0, 1.0]),
        "action": torch.tensor([0.3, 0.2]),
        "action_agent": torch.tensor([0.4, -0.6]),
        "intervention": torch.tensor([True]),
        "next": {
            "observation": torch.tensor([7.5, 0.4, 1.9, 1.1]),
            "takeover_cost": torch.tensor([0.25]),
        },
    }
    return TensorDict(data).expand(count).clone()


def test_a_mirrored_transition_by_hand():
    seen = ROAD(transition(), share=1.0)[0]
    assert seen["observation"].tolist() == pytest.approx([7.0, -0.5, 1.0, 2.0])
    assert seen["next", "observation"].tolist() == pytest.approx([7.5, -0.4, 1.1, 1.9])
    assert seen["action"].tolist() == pytest.approx([0.3, -0.2])
    assert seen["action_agent"].tolist() == pytest.approx([0.4, 0.6])
    assert seen["next", "takeover_cost"].item() == 0.25
    assert seen["intervention"].item()


def test_a_transition_is_mirrored_as_a_whole_or_not_at_all():
    torch.manual_seed(0)
    seen = ROAD(transition(1000), share=0.3)
    flipped = seen["observation"][:, 1] < 0
    assert 250 < flipped.sum() < 350
    for entry, index in (("action", 1), (("next", "observation"), 1)):
        assert ((seen[entry][:, index] < 0) == flipped).all()
    assert ((seen["action_agent"][:, 1] > 0) == flipped).all()


def test_the_replay_mirrors_what_it_samples_and_not_what_it_stores():
    replay = TakeoverReplayBuffer(10, 200, reflection=ROAD, mirrored=0.5)
    replay.extend(transition())
    wheel = replay.sample()["action"][:, 1]
    assert wheel.unique().tolist() == pytest.approx([-0.2, 0.2])
    assert replay.intervened.columns()["action"][0].tolist() == pytest.approx([0.3, 0.2])


def test_a_world_without_the_symmetry_is_refused():
    with pytest.raises(ValueError, match=r"mirrored is 0\.5, but this world does not say"):
        TakeoverReplayBuffer(10, mirrored=0.5)


@pytest.mark.parametrize(
    ("order", "sign", "message"),
    [
        ((0, 0), (1.0, 1.0), "permutation"),
        ((0, 1), (1.0,), "as long as"),
        ((0, 1), (1.0, 0.5), "1 or -1"),
        ((1, 2, 0), (1.0, 1.0, 1.0), "mirrored twice"),
        ((1, 0), (1.0, -1.0), "mirrored twice"),
    ],
)
def test_what_is_no_reflection_is_refused(order, sign, message):
    with pytest.raises(ValueError, match=message):
        Reflection(order, sign, (1.0,))


def test_images_are_mirrored_with_the_transition_they_belong_to():
    """Columns are exchanged, bytes stay bytes, and the speed beside the image stays as it is."""
    mirror = Reflection((), (), (1.0, -1.0), observation_keys=(), image_keys=("pixels",))
    pixels = torch.tensor([[[1, 2, 3], [4, 5, 6]]], dtype=torch.uint8)
    data = {"pixels": pixels, "state": torch.tensor([0.5]), "action": torch.tensor([0.3, 0.2])}
    torch.manual_seed(0)
    seen = mirror(TensorDict(data).expand(200).clone(), share=0.5)
    flipped = seen["action"][:, 1] < 0
    assert 70 < flipped.sum() < 130
    assert seen["pixels"].dtype == torch.uint8
    assert (seen["pixels"][flipped] == pixels.flip(-1)).all()
    assert (seen["pixels"][~flipped] == pixels).all()
    assert (seen["state"] == 0.5).all()
