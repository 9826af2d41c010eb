"""Adversarial imitation: the reward is to be taken for an expert."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import GAILLoss

from haim_torchrl.objectives.on_policy.functional import imitation_reward
from haim_torchrl.objectives.on_policy.learner import JointLoss, ValueFactory
from haim_torchrl.objectives.on_policy.ppo import ProximalLearner
from haim_torchrl.objectives.optimization import UpdateStep


class GAILLearner(ProximalLearner):
    """Generative adversarial imitation learning (Ho and Ermon, NeurIPS 2016).

    A discriminator learns to tell the pairs of state and action of a batch from those of an expert
    (TorchRL's ``GAILLoss``, which is made to read log-odds: of a probability that has come to 0 or
    1 there is no gradient left). The policy learns by proximal policy optimisation to be taken for
    the expert (:func:`~haim_torchrl.objectives.on_policy.functional.imitation_reward`). Reward and
    cost of the environment are not read.

    Args:
        actor: the policy.
        make_value: makes the value network.
        make_discriminator: makes the discriminator, which writes ``logits`` and ``d_logits`` (see
            :func:`~haim_torchrl.modules.make_discriminator`).
        demonstrations: ``[N]`` with ``observation`` and ``action`` of the expert.
        discriminator_lr: its learning rate (Adam).
        discriminator_steps: its gradient steps for each batch, at least 1.
        discriminator_batch_size: pairs of each kind in one step, at least 1.
        gradient_penalty: weight of TorchRL's gradient penalty, on the log-odds; 0 for none.
        reward: ``positive`` for -log(1 - D), ``logit`` for log D - log(1 - D); see
            :func:`~haim_torchrl.objectives.on_policy.functional.imitation_reward`.
        **options: of :class:`~haim_torchrl.objectives.on_policy.ppo.ProximalLearner`.

    Raises:
        ValueError: if a number is out of range, or the demonstrations are not of these spaces.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        make_value: ValueFactory,
        make_discriminator: Callable[[], TensorDictModule],
        demonstrations: TensorDictBase,
        *,
        discriminator_lr: float = 3e-4,
        discriminator_steps: int = 100,
        discriminator_batch_size: int = 256,
        gradient_penalty: float = 0.0,
        reward: str = "positive",
        **options: Any,
    ) -> None:
        super().__init__(actor, make_value, **options)
        for name, count in (
            ("discriminator_steps", discriminator_steps),
            ("discriminator_batch_size", discriminator_batch_size),
        ):
            if count < 1:
                raise ValueError(f"{name} must be at least 1, got {count}.")
        if gradient_penalty < 0.0:
            raise ValueError(f"gradient_penalty must be at least 0, got {gradient_penalty}.")
        if reward not in ("positive", "logit"):
            raise ValueError(f"reward must be positive or logit, got {reward!r}.")
        self.reward_form = reward
        (self._seen,) = actor.in_keys
        device = next(actor.parameters()).device
        pairs = demonstrations.select(self._seen, "action").to(device)
        if not len(pairs):
            raise ValueError("demonstrations must hold at least one transition, got none.")
        self.demonstrations = pairs
        self.discriminator_steps = discriminator_steps
        self.discriminator_batch_size = discriminator_batch_size
        self.discriminator = make_discriminator()
        with warnings.catch_warnings():  # about a target network, which this loss has none of
            warnings.simplefilter("ignore", UserWarning)
            gail = GAILLoss(
                self.discriminator,
                use_grad_penalty=gradient_penalty > 0.0,
                gp_lambda=gradient_penalty,
            )
        gail.set_keys(expert_observation=self._seen, discriminator_pred="logits")
        gail.loss_function = nn.BCEWithLogitsLoss(reduction="none")  # it offers no setting for it
        loss = JointLoss({"discriminator": gail})
        optimizer = Adam(self.discriminator.parameters(), lr=discriminator_lr, fused=True)
        self.discriminate = UpdateStep(loss, optimizer)
        self._parts |= {"discriminator": loss, "discriminator_optimizer": optimizer}
        self._figures: dict[str, Tensor] = {}

    @property
    def signals(self) -> Sequence[NestedKey]:
        """Nothing: what a step is worth is the discriminator's to say."""
        return []

    def reward(self, data: TensorDictBase) -> Tensor:
        """Trains the discriminator on the batch, and asks it what each step is worth."""
        own = data.select(self._seen, "action").reshape(-1)
        loss = torch.stack([self._tell_apart(own) for _ in range(self.discriminator_steps)]).mean()
        with torch.no_grad():
            judged = self.discriminator(data.select(self._seen, "action"))
        logits = judged["logits"]
        reward = logits if self.reward_form == "logit" else imitation_reward(logits)
        self._figures = {
            "discriminator_loss": loss,
            "imitation_reward": reward.mean(),
            "taken_for_expert": judged["d_logits"].mean(),
        }
        return reward

    def _tell_apart(self, own: TensorDictBase) -> Tensor:
        size = self.discriminator_batch_size
        mine, experts = (
            source[torch.randint(len(source), (size,), device=source.device)]
            for source in (own, self.demonstrations)
        )
        pairs = TensorDict(
            {
                self._seen: experts[self._seen],
                "action": experts["action"],
                "collector_observation": mine[self._seen],
                "collector_action": mine["action"],
            },
            batch_size=[size],
            device=own.device,
        )
        return self.discriminate(pairs)["loss_discriminator"]

    def figures(self) -> dict[str, Tensor]:
        """How well both are told apart, and what a step is worth."""
        return self._figures
