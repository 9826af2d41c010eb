"""Cloning of an ensemble: values by hand, weights, and TorchRL's loss for each member."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.objectives import BCLoss

from haim_torchrl.modules import make_actor, make_ensemble_actor
from haim_torchrl.objectives import EnsembleCloningLoss
from haim_torchrl.objectives.functional import ensemble_distance


class Constant(nn.Module):
    """Two members that always do what they say, and their variance as the doubt."""

    def __init__(self, *actions: float) -> None:
        super().__init__()
        self.actions = nn.Parameter(torch.tensor(actions).unsqueeze(-1))

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        actions = self.actions.expand(*observation.shape[:-1], -1, 1)
        return actions, actions.mean(-2), actions.var(-2)


def loss_of(*actions: float, reduction: str | None = None) -> EnsembleCloningLoss:
    keys = ["action_members", "action", "doubt"]
    actor = TensorDictModule(Constant(*actions), in_keys=["observation"], out_keys=keys)
    return EnsembleCloningLoss(actor, reduction=reduction)


def samples(*actions: float) -> TensorDict:
    done = torch.tensor(actions).unsqueeze(-1)
    return TensorDict(
        {"observation": torch.zeros(len(actions), 1), "action": done}, batch_size=[len(actions)]
    )


def test_the_distance_by_hand() -> None:
    members = torch.tensor([[1.0, 0.0], [-1.0, 2.0]])
    # (1² + 0²) and (1² + 2²), four numbers in all
    assert ensemble_distance(members, torch.zeros(2)).tolist() == [1.5]
    with pytest.raises(ValueError, match=r"\[\.\.\., E, A\]"):
        ensemble_distance(torch.zeros(5, 2), torch.zeros(5, 2))


def test_the_loss_by_hand() -> None:
    loss = loss_of(1.0, -1.0)
    # The mean action 0 is right for the first sample, and each member is 1 off all the same.
    result = loss(samples(0.0, 1.0))
    assert result["loss_cloning"].item() == pytest.approx((1.0 + 2.0) / 2)
    assert result["doubt"].item() == 2.0
    assert not result["doubt"].requires_grad
    result["loss_cloning"].backward()
    # d/da_e of the mean over two samples and two members: (a_e - 0 + a_e - 1) / 2
    (gradient,) = [parameter.grad for parameter in loss.parameters()]
    assert gradient.squeeze(-1).tolist() == [0.5, -1.5]


def test_weights_of_samples_count() -> None:
    batch = samples(0.0, 1.0).set("priority_weight", torch.tensor([3.0, 1.0]))
    assert loss_of(1.0, -1.0, reduction="none")(batch)["loss_cloning"].tolist() == [3.0, 2.0]
    # weighted mean of the distances 1 and 2
    assert loss_of(1.0, -1.0)(batch)["loss_cloning"].item() == pytest.approx(5.0 / 4.0)


@pytest.mark.filterwarnings("ignore:The name target_actor_network_params")
def test_each_member_learns_as_if_it_were_alone() -> None:
    torch.manual_seed(0)
    policy = make_ensemble_actor(3, 2, hidden=(8,), members=2)
    batch = TensorDict(
        {"observation": torch.randn(16, 3), "action": torch.rand(16, 2) * 2 - 1}, batch_size=[16]
    )
    alone = []
    for member in policy.module.members:

        def act(observation: Tensor, member: nn.Module = member) -> Tensor:
            return member(observation)[0].tanh()

        network = TensorDictModule(act, in_keys=["observation"], out_keys=["action"])
        network.member = member
        alone.append(BCLoss(network, loss_function="l2")(batch)["loss_bc"])
    loss = EnsembleCloningLoss(policy)
    together = loss(batch)["loss_cloning"]
    torch.testing.assert_close(together, torch.stack(alone).mean())


def test_every_member_is_fitted() -> None:
    torch.manual_seed(0)
    policy = make_ensemble_actor(2, 1, hidden=(32,), members=3)
    loss = EnsembleCloningLoss(policy)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-2)
    seen = torch.rand(256, 2) * 2 - 1
    wanted = 0.5 * seen[:, :1] - 0.3 * seen[:, 1:]
    batch = TensorDict({"observation": seen, "action": wanted}, batch_size=[256])
    for _ in range(200):
        optimizer.zero_grad()
        loss(batch)["loss_cloning"].backward()
        optimizer.step()
    done = policy(batch.select("observation"))["action_members"]
    assert (done - wanted.unsqueeze(1)).abs().mean((0, 2)).max() < 0.05


def test_a_policy_that_is_no_ensemble_is_named() -> None:
    loss = EnsembleCloningLoss(make_actor(1, 1))
    with pytest.raises(ValueError, match="but not 'action_members'; use make_ensemble_actor"):
        loss(samples(0.0))


def test_a_missing_action_is_named() -> None:
    with pytest.raises(KeyError, match="EnsembleCloningLoss needs the entry 'action'"):
        loss_of(1.0, -1.0)(samples(0.0).exclude("action"))
