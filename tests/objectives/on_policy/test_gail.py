"""Adversarial imitation of an expert that is known."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import make_discriminator
from haim_torchrl.objectives.on_policy import GAILLearner

from .bandit import drive, make_small_value, train


def see(steps: int) -> Tensor:
    return 2.0 * torch.rand(steps, 1) - 1.0


def expert(observation: Tensor) -> Tensor:
    return -0.6 * observation


def demonstrations(count: int = 500) -> TensorDict:
    seen = see(count)
    action = (expert(seen) + 0.05 * torch.randn_like(seen)).clamp(-1.0, 1.0)
    return TensorDict(observation=seen, action=action, batch_size=[count])


def imitator(actor: ProbabilisticActor, **options: Any) -> GAILLearner:
    settings: dict[str, Any] = {
        "discriminator_lr": 1e-2,
        "discriminator_steps": 10,
        "discriminator_batch_size": 128,
        "lr": 3e-3,
        "epochs": 4,
        "minibatch_size": 128,
        **options,
    }
    discriminator = partial(make_discriminator, 1, 1, (32,))
    shown = settings.pop("demonstrations", None)
    shown = demonstrations() if shown is None else shown
    return GAILLearner(
        actor, make_small_value, make_discriminator=discriminator, demonstrations=shown, **settings
    )


def distance(actor: ProbabilisticActor) -> float:
    seen = see(1000)
    with torch.no_grad():
        acted = actor(TensorDict(observation=seen, batch_size=[1000]))["action"]
    return float((acted - expert(seen)).abs().mean())


def test_the_expert_is_recovered(actor: ProbabilisticActor) -> None:
    before = distance(actor)
    train(imitator(actor), rounds=50, observe=see)
    assert before > 0.25
    assert distance(actor) < 0.1


def test_reward_and_cost_are_not_read(actor: ProbabilisticActor) -> None:
    learner = imitator(actor)
    assert not {"reward", "cost"} & {key[-1] for key in learner.in_keys}
    batch = drive(actor, 64, observe=see)
    assert list(learner.learn(batch.exclude(("next", "reward"), ("next", "cost"))))


def test_the_discriminator_learns_to_tell(actor: ProbabilisticActor) -> None:
    learner = imitator(actor, discriminator_steps=200)
    batch = drive(actor, 256, observe=lambda steps: torch.full((steps, 1), 0.9))
    figures = list(learner.learn(batch))[-1]
    assert float(figures["taken_for_expert"]) < 0.3
    shown = learner.discriminator(demonstrations())
    assert shown["d_logits"].mean().item() > 0.7


def test_a_discriminator_that_is_sure_and_wrong_still_learns(actor: ProbabilisticActor) -> None:
    learner = imitator(actor, discriminator_steps=1)
    with torch.no_grad():  # log-odds of -200 for everything: the probability is 0
        layers = learner.discriminator[0].module
        layers[-1].weight.zero_()
        layers[-1].bias.fill_(-200.0)
    list(learner.learn(drive(actor, 64, observe=see)))
    # -log D of the expert's pairs is 200, its slope -1; the policy's pairs have neither.
    assert float(learner.figures()["discriminator_loss"]) == pytest.approx(200.0, rel=1e-3)
    assert layers[-1].bias.item() > -200.0


def test_the_reward_can_be_the_log_odds(actor: ProbabilisticActor) -> None:
    learner = imitator(actor, reward="logit", discriminator_steps=1)
    data = learner.prepare(drive(actor, 64, observe=see))
    worth = learner.reward(data)
    torch.testing.assert_close(worth, learner.discriminator(data)["logits"].detach())
    assert learner.figures()["imitation_reward"].item() == pytest.approx(worth.mean().item())


def test_a_gradient_penalty_can_be_had(actor: ProbabilisticActor) -> None:
    learner = imitator(actor, gradient_penalty=1.0)
    assert list(learner.learn(drive(actor, 64, observe=see)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"discriminator_steps": 0}, "discriminator_steps must be at least 1"),
        ({"reward": "log"}, "reward must be positive or logit, got 'log'"),
        ({"gradient_penalty": -1.0}, "gradient_penalty must be at least 0"),
        ({"demonstrations": demonstrations(0)}, "at least one transition"),
    ],
)
def test_what_cannot_be_learned_from_is_named(
    options: dict[str, Any], words: str, actor: ProbabilisticActor
) -> None:
    with pytest.raises(ValueError, match=words):
        imitator(actor, **options)
