"""The scenarios: each does to a published policy what it promises.

Their obstacles need the engine on CPU threads, the only one that can follow contacts one by one.
"""

import numpy as np
import pytest
import torch

from ppt_rl.evaluation import collide, load_policy
from ppt_rl.evaluation.disturbed import in_scenario
from ppt_rl.tasks.push.faults import WrongWrenchTransform
from ppt_rl.tasks.push.scenarios import SCENARIOS

NAMES = ("blocked", "jammed", "hand", "jump", "stiff", "table", "release", "sensor")


@pytest.fixture(scope="module")
def policy():
    return load_policy("pp_push").with_changes(num_threads=1, engine="threads")


@pytest.fixture(scope="module")
def rows(policy):
    """Two episodes of PP in every scenario."""
    return collide({"pp": policy}, episodes=2, seed=7).rows["pp"]


def test_the_scenarios_have_the_promised_names():
    assert tuple(scenario.name for scenario in SCENARIOS) == NAMES


@pytest.mark.filterwarnings("ignore:the impedance is unstable")
def test_the_tool_or_the_box_meets_the_obstacle_in_every_scenario(rows):
    for name in NAMES:
        assert (rows[name]["contact"] == 1).all(), name
        assert (rows[name]["peak_force"] >= rows[name]["static_force"]).all(), name
        assert (rows[name]["peak_force"] > (2 if name == "table" else 20)).all(), name


@pytest.mark.filterwarnings("ignore:the impedance is unstable")
def test_a_wall_stops_the_tool_at_speed_and_a_hand_that_is_free_gets_away(rows):
    assert (rows["blocked"]["contact_speed"] > 0.25).all()
    assert (rows["blocked"]["static_force"] > 10).all()
    constrained, free = rows["hand"]["static_force"]
    assert constrained > 10 > 1 > free


@pytest.mark.filterwarnings("ignore:the impedance is unstable")
def test_faults_are_worse_than_the_wall_alone(rows):
    assert (rows["jump"]["spring_energy"] > rows["blocked"]["spring_energy"]).all()
    assert (rows["stiff"]["spring_energy"] > 2 * rows["blocked"]["spring_energy"]).all()
    assert (rows["release"]["held_force"] > 20).all()


def test_another_seed_draws_other_episodes(policy, rows):
    other = collide({"pp": policy}, scenarios=("blocked",), episodes=2, seed=8).rows["pp"]["blocked"]
    assert (other["peak_force"] != rows["blocked"]["peak_force"]).all()


def test_the_same_seed_gives_the_same_forces_to_a_policy_that_reads_no_wrench_however_wrong_it_is(rows):
    for name in ("peak_force", "static_force", "true_work", "spring_energy", "contact_time"):
        np.testing.assert_array_equal(rows["sensor"][name], rows["blocked"][name])


def test_the_wrench_is_late_in_episodes_of_one_kind_and_halved_in_the_others(policy):
    sensor = in_scenario(policy, next(scenario for scenario in SCENARIOS if scenario.name == "sensor"))
    base = sensor.recipe.task.make_test_env(sensor.config, num_envs=2, seed=0, audit=False)
    true = []
    observe = base._observation

    def recorded():
        found = observe()
        true.append(found["wrench"].clone())
        return found

    base._observation = recorded
    env = base.append_transform(WrongWrenchTransform(2, 0.5))
    tensordict = env.reset()
    read = [tensordict["wrench"]]
    for _ in range(6):
        tensordict = env.step(env.rand_action(tensordict))["next"]
        read.append(tensordict["wrench"])
    for step in range(7):
        assert torch.equal(read[step][0], true[max(0, step - 2)][0])
        assert torch.equal(read[step][1], 0.5 * true[step][1])


@pytest.mark.parametrize("name", ["ppt_push", "st_push"])
def test_a_jump_enters_outside_of_what_acts_on_the_reference(name):
    jump = in_scenario(
        load_policy(name).with_changes(engine="threads"),
        next(scenario for scenario in SCENARIOS if scenario.name == "jump"),
    )
    base = jump.recipe.task.make_test_env(jump.config, num_envs=1, seed=0, audit=False)
    chain = [type(part).__name__ for part in jump.recipe.make_chain(jump.config, base, **jump.modules)]
    place = chain.index("JumpingReferenceTransform")
    assert chain.index("ImpedanceTransform") < chain.index("SpringEnergyTransform") < place
    assert chain[place + 1] in ("MacroStepTransform", "CartesianVelocityTransform")
