"""Each loss module against numbers worked out by hand on linear critics.

The policy is a = s / 2 with log-density 0.5 - 1.2 = -0.7. The batch has three transitions
(s, a, a_agent, s'): (2, 1, -1, 4) taken over, (1, -1, -1, 2) terminated, (0, 0.5, 0.5, 6)
truncated. So the next actions are 2, 1 and 3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import Temperature
from haim_torchrl.objectives import (
    ActorLoss,
    BoundedPreferenceLoss,
    CloningAnchorLoss,
    ConservativePreferenceLoss,
    CostCriticLoss,
    ExplicitInterventionLoss,
    ImplicitInterventionLoss,
    LinearPreferenceLoss,
    LossTerm,
    ProxyQLoss,
    TargetUpdater,
    TemperatureLoss,
)

MakeCritic = Callable[..., TensorDictModule]
TWINS = ((1.0, 2.0), (3.0, -1.0))


def evaluate(term: LossTerm, batch: TensorDict) -> TensorDict:
    if any(name.startswith("target_") for name, _ in term.named_children()):
        TargetUpdater(term, tau=1.0)
    return term(batch)


def test_proxy_loss(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = ProxyQLoss(actor, make_linear_critic(*TWINS), 0.1, reduction="none")
    term.make_value_estimator(gamma=0.9)
    result = evaluate(term, batch)
    # Values at s' = 4, 2, 6: twins (8, 10), terminated, (12, 15); the executed action counts.
    # y = 0.9 (8 + 0.07) = 7.263, 0, 0.9 (12 + 0.07) = 10.863 (bootstraps through truncation)
    # Q(s, a): (4, 5), (-1, 4), (1, -0.5)
    expected = torch.tensor(
        [
            0.5 * ((4 - 7.263) ** 2 + (5 - 7.263) ** 2),
            0.5 * (1 + 16),
            0.5 * ((1 - 10.863) ** 2 + (-0.5 - 10.863) ** 2),
        ]
    )
    torch.testing.assert_close(result["loss_proxy_q"], expected)
    torch.testing.assert_close(result["proxy_q_mean"], torch.tensor(12.5 / 6))
    torch.testing.assert_close(result["proxy_q_abs_mean"], torch.tensor(15.5 / 6))
    torch.testing.assert_close(result["proxy_q_abs_max"], torch.tensor(5.0))
    errors = torch.tensor([7.263 - 4, 4.0, 10.863 + 0.5])
    torch.testing.assert_close(result["proxy_q_td_error"], errors.mean())
    torch.testing.assert_close(batch["td_error"], errors)


def test_proxy_loss_reads_no_reward(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = ProxyQLoss(actor, make_linear_critic(*TWINS), 0.1)
    before = evaluate(term, batch)["loss_proxy_q"]
    after = evaluate(term, batch.set(("next", "reward"), torch.full((3, 1), 100.0)))
    torch.testing.assert_close(after["loss_proxy_q"], before)


@pytest.mark.parametrize(
    ("kind", "name", "costs"),
    [
        (ExplicitInterventionLoss, "explicit", (2.0, 0.0, 0.0)),
        (ImplicitInterventionLoss, "implicit", (0.0, 0.5, 0.25)),
    ],
)
def test_cost_losses(
    kind: type[CostCriticLoss],
    name: str,
    costs: tuple[float, float, float],
    actor: ProbabilisticActor,
    make_linear_critic: MakeCritic,
    batch: TensorDict,
) -> None:
    options = {"intervened": True} if kind is ImplicitInterventionLoss else {}
    critic = make_linear_critic(*TWINS)
    term = kind(actor, critic, target_reduction="max", reduction="none", **options)
    term.make_value_estimator(gamma=0.9)
    result = evaluate(term, batch)
    # The larger twin at s': 10, terminated, 15. No entropy. Q at the agent's proposal:
    # (0, 7), (-1, 4), (1, -0.5)
    targets = costs[0] + 9.0, costs[1], costs[2] + 13.5
    values = (0.0, 7.0), (-1.0, 4.0), (1.0, -0.5)
    expected = torch.tensor(
        [0.5 * ((q1 - y) ** 2 + (q2 - y) ** 2) for (q1, q2), y in zip(values, targets)]
    )
    torch.testing.assert_close(result[f"loss_{name}"], expected)
    assert set(result.keys()) == set(term.out_keys)


def test_cost_loss_with_smaller_twin_and_own_names(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = CostCriticLoss(actor, make_linear_critic(*TWINS), label="risk", reduction="sum")
    term.set_keys(cost="takeover_cost")
    term.make_value_estimator(gamma=0.5)
    targets = 2.0 + 0.5 * 8.0, 0.0, 0.5 * 12.0
    values = (0.0, 7.0), (-1.0, 4.0), (1.0, -0.5)
    expected = sum(0.5 * ((q1 - y) ** 2 + (q2 - y) ** 2) for (q1, q2), y in zip(values, targets))
    torch.testing.assert_close(evaluate(term, batch)["loss_risk"], torch.tensor(expected))


def test_linear_preference_averages_over_the_whole_batch(
    make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    result = LinearPreferenceLoss(make_linear_critic(*TWINS))(batch)
    # Taken over: agent (0, 7), mentor (4, 5): 10 * (-4 + 2) / 3
    torch.testing.assert_close(result["loss_preference"], torch.tensor(-20.0 / 3))
    torch.testing.assert_close(result["preference_share"], torch.tensor(1 / 3))
    torch.testing.assert_close(result["preference_margin"], torch.tensor(1.0))


def test_bounded_preference_averages_over_interventions(
    make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    result = BoundedPreferenceLoss(make_linear_critic(*TWINS))(batch)
    # ((4 - 1)^2 + (5 - 1)^2 + (0 + 1)^2 + (7 + 1)^2) / 2
    torch.testing.assert_close(result["loss_preference"], torch.tensor(45.0))


@pytest.mark.parametrize(
    ("reduction", "expected"), [("none", (0.0, 7.25, 182.8125)), ("mean", 95.03125)]
)
def test_the_disturbance_critic_leaves_out_the_mentors_steps(
    reduction: str,
    expected: float | tuple[float, ...],
    actor: ProbabilisticActor,
    make_linear_critic: MakeCritic,
    batch: TensorDict,
) -> None:
    critic = make_linear_critic(*TWINS)
    term = ImplicitInterventionLoss(actor, critic, target_reduction="max", reduction=reduction)
    term.make_value_estimator(gamma=0.9)
    # As above without the first: ((-1 - 0.5)^2 + (4 - 0.5)^2) / 2 and, with the target
    # 0.25 + 13.5, ((1 - 13.75)^2 + (-0.5 - 13.75)^2) / 2.
    loss = evaluate(term, batch)["loss_implicit"]
    torch.testing.assert_close(loss.squeeze(), torch.tensor(expected))
    assert "intervention" in term.in_keys


def test_conservative_preference_rejects_what_the_policy_would_do_now_too(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    critic = make_linear_critic(*TWINS)
    result = ConservativePreferenceLoss(actor, critic)(batch)
    # Half of it as the bounded one, 45. For the other half the fresh action is 0.5 s = 1, which is
    # the mentor's own: ((4 - 1)^2 + (5 - 1)^2 + (4 + 1)^2 + (5 + 1)^2) / 2 = 43.
    torch.testing.assert_close(result["loss_preference"], torch.tensor(44.0))
    # Mentor: mean 4.5; rejected: (0 + 7 + 4 + 5) / 4.
    torch.testing.assert_close(result["preference_margin"], torch.tensor(0.5))
    result["loss_preference"].backward()
    assert all(parameter.grad is None for parameter in actor.parameters())
    assert critic.module.weight.grad.abs().sum() > 0


@pytest.mark.parametrize("kind", [LinearPreferenceLoss, BoundedPreferenceLoss])
def test_preference_of_a_batch_without_interventions_is_zero(
    kind: Callable[..., LossTerm], make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    critic = make_linear_critic(*TWINS)
    result = kind(critic)(batch.set("intervention", torch.zeros(3, 1, dtype=torch.bool)))
    assert all(value.item() == 0.0 for value in result.values())
    result["loss_preference"].backward()
    torch.testing.assert_close(critic.module.weight.grad, torch.zeros(2, 2))


def test_preference_can_read_the_mentors_action_from_its_own_entry(
    make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = LinearPreferenceLoss(make_linear_critic(*TWINS))
    batch["action_mentor"][0] = 3.0
    term.set_keys(action_mentor="action_mentor")
    # mentor's action 3 instead of 1: values (8, 3)
    torch.testing.assert_close(term(batch)["loss_preference"], torch.tensor(10 * (-8 + 4) / 3.0))


def test_preference_weight_is_schedulable(
    make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = LinearPreferenceLoss(make_linear_critic(*TWINS))
    term.weight = 1.0
    torch.testing.assert_close(term(batch)["loss_preference"], torch.tensor(-2.0 / 3))


def test_actor_loss(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    critics = {
        "proxy": (make_linear_critic(*TWINS), 1.0, "min"),
        "explicit": (make_linear_critic((0.0, 1.0), (1.0, 1.0)), -2.0, "max"),
    }
    result = ActorLoss(actor, critics, 0.1, reduction="none")(batch)
    # s = 2, 1, 0 and a = 1, 0.5, 0: proxy min(4, 5), min(2, 2.5), 0; explicit max: 3, 1.5, 0
    # loss = 0.1 * -0.7 - proxy + 2 * explicit
    torch.testing.assert_close(result["loss_actor"], torch.tensor([1.93, 0.93, -0.07]))
    torch.testing.assert_close(result["actor_proxy"], torch.tensor(2.0))
    torch.testing.assert_close(result["actor_explicit"], torch.tensor(1.5))
    torch.testing.assert_close(result["entropy"], torch.tensor(0.7))
    torch.testing.assert_close(result["alpha"], torch.tensor(0.1))


def test_actor_gradient_goes_uphill_in_value_and_entropy(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    critic = make_linear_critic((0.0, 1.0), (0.0, 1.0))
    ActorLoss(actor, {"proxy": (critic, 1.0, "min")}, 0.1)(batch)["loss_actor"].backward()
    gain = next(actor.parameters())
    # d/dgain of mean(0.1 (gain - 1.2) - gain s) = 0.1 - (2 + 1 + 0) / 3
    torch.testing.assert_close(gain.grad, torch.tensor([-0.9]))
    assert critic.module.weight.grad is None


def test_temperature_loss_targets_minus_the_action_dimensions(
    actor: ProbabilisticActor, batch: TensorDict
) -> None:
    temperature = Temperature(2.0)
    TemperatureLoss(actor, temperature)(batch)["loss_temperature"].backward()
    # -(log_prob + target) = -(-0.7 - 1)
    torch.testing.assert_close(temperature.log_alpha.grad, torch.tensor(1.7))
    assert all(parameter.grad is None for parameter in actor.parameters())


def test_temperature_loss_with_a_given_target(actor: ProbabilisticActor, batch: TensorDict) -> None:
    temperature = Temperature(2.0)
    term = TemperatureLoss(actor, temperature, target_entropy=0.2)
    expected = -temperature.log_alpha.detach() * (-0.7 + 0.2)
    torch.testing.assert_close(term(batch)["loss_temperature"].detach(), expected)


def test_anchor_draws_to_the_mentor_where_it_drove(
    actor: ProbabilisticActor, batch: TensorDict
) -> None:
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.fill_(1.0)
    term = CloningAnchorLoss(actor, weight=3.0, reduction="none")
    # The policy does 2 where the mentor did 1: 3 * (2 - 1)^2 / 2. It drove nowhere else.
    loss = term(batch)["loss_anchor"]
    torch.testing.assert_close(loss.detach(), torch.tensor([1.5, 0.0, 0.0]))
    loss.sum().backward()
    # d/dgain of 3 (gain s - 1)^2 / 2 at s = 2 is 3 (2 - 1) 2
    gradient = sum(float(p.grad.sum()) for p in term.trained_parameters() if p.grad is not None)
    assert gradient == pytest.approx(6.0)


def test_n_step_batches_are_discounted_n_times(
    actor: ProbabilisticActor, make_linear_critic: MakeCritic, batch: TensorDict
) -> None:
    term = ExplicitInterventionLoss(actor, make_linear_critic((0.0, 0.0)), reduction="none")
    TargetUpdater(term)
    with torch.no_grad():
        term.target_critic_network_params["module", "weight"].fill_(1.0)
    term.make_value_estimator(gamma=0.5)
    batch["steps_to_next_obs"] = torch.tensor([[1], [1], [3]])
    # Q' = s' + a' = 6, terminated, 9; y = 2 + 3, 0, 9 / 8
    expected = 0.5 * torch.tensor([5.0, 0.0, 1.125]) ** 2
    torch.testing.assert_close(evaluate(term, batch)["loss_explicit"], expected)


def test_a_reset_takes_the_temperature_back_to_its_start(method: Any) -> None:
    temperature = method.loss.terms["temperature"].temperature
    start = temperature().item()
    with torch.no_grad():
        temperature.log_alpha.add_(1.0)
    method.loss.reset_parameters_recursive()
    assert temperature().item() == pytest.approx(start)
