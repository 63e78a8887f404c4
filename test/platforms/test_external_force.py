"""A force from outside on a body of a robot in MuJoCo: what it does, and what is refused."""

import mujoco
import numpy as np
import pytest

from unicon_base import Fault
from unicon_core.platforms.platform import TakesForces
from unicon_core.states import States, standard_states
from unicon_core.states.standard import external_states

BOX = 2  # its number in the model; 1 is a ball that belongs to nobody


@pytest.fixture
def states_of():
    """Builds the standard states of a robot, and those of the force."""

    def build(robot, num_robots=None):
        return States(standard_states(robot.joint_names) | external_states(), num_robots)

    return build


def pull(states, force, body=BOX, point=(0.0, 0.0, 2.0)):
    states["external_force"][...] = force
    states["external_force_point"][...] = point
    states["external_force_body"][...] = body


def without_rotors(platform):
    """Let joints have no inertia beyond that of bodies, which would carry no momentum."""
    for robot in platform.robots:
        robot.model.dof_armature[:] = 0.0
    return platform


def momentum(platform, rank=0):
    """Of a robot, linear and around its mass centre, shape (2, 3)."""
    robot = platform.robots[rank]
    mujoco.mj_subtreeVel(robot.model, robot.data)
    mass = robot.model.body_subtreemass[BOX]
    return np.array([mass * robot.data.subtree_linvel[BOX], robot.data.subtree_angmom[BOX]])


def test_a_force_gives_its_impulse_and_ends_with_its_tick(build):
    (free, _), (platform, states) = build(period=0.01), build(period=0.01)
    force = np.array((30.0, -20.0, 5.0))
    for each in (free, platform):
        without_rotors(each)
    pull(states, force)
    free.send()
    platform.send()
    assert momentum(platform)[0] - momentum(free)[0] == pytest.approx(0.01 * force, abs=0.02)
    assert platform.data.xfrc_applied.any()
    pull(states, force, 0)
    platform.send()
    assert not platform.data.xfrc_applied.any()


def test_a_force_beside_the_mass_centre_turns_the_robot(build):
    (straight, one), (turned, other) = build(period=0.01), build(period=0.01)
    centre = straight.data.subtree_com[BOX].copy()
    lever, force = np.array((0.0, 0.3, 0.0)), np.array((20.0, 0.0, 0.0))
    pull(one, force, point=centre)
    pull(other, force, point=centre + lever)
    for platform in (straight, turned):
        platform.send()
    gained = momentum(turned)[1] - momentum(straight)[1]
    assert gained == pytest.approx(0.01 * np.cross(lever, force), abs=2e-3)


def test_each_robot_of_a_batch_feels_its_own(build):
    platform, states = build(period=0.01, num_robots=2)
    without_rotors(platform)
    pull(states, np.array([(0.0, 0.0, 0.0), (40.0, 0.0, 0.0)]), [0, BOX])
    platform.send()
    assert momentum(platform, 0)[0, 0] == pytest.approx(0.0, abs=1e-3)
    assert momentum(platform, 1)[0, 0] == pytest.approx(0.4, rel=0.02)


@pytest.mark.parametrize("again", ["reset", "load"])
def test_a_force_is_gone_after_a_beginning_anew(build, again):
    platform, states = build(period=0.01)
    begun = platform.save()
    runs = []
    for forced in (False, True, False):
        pull(states, (30.0, 0.0, 0.0), BOX if forced else 0)
        platform.send()
        runs.append(platform.data.qvel.tobytes())
        platform.reset() if again == "reset" else platform.load(begun)
    assert runs[0] == runs[2] != runs[1]
    pull(states, (30.0, 0.0, 0.0))
    platform.send()
    under_force = platform.save()  # the force of the tick is among what is kept
    pull(states, 0.0, 0)
    after = []
    for _ in range(2):
        platform.load(under_force)
        platform.send()
        after.append(platform.data.qvel.tobytes())
    assert after[0] == after[1]
    assert not platform.data.xfrc_applied.any()


@pytest.mark.parametrize(
    ("force", "body", "said"),
    [
        ((np.nan, 0.0, 0.0), BOX, "nan.* on body 2 is none; give finite numbers"),
        ((1.0, 0.0, 0.0), 99, "on body 99 is none; .*a body from 1 to "),
        ((1.0, 0.0, 0.0), -1, "on body -1 is none"),
    ],
)
def test_a_force_that_is_none_ends_the_run(build, force, body, said):
    platform, states = build()
    pull(states, force, body)
    with pytest.raises(Fault, match=said):
        platform.send()


def test_it_tells_bodies_points_and_weight(build):
    platform, _ = build()
    assert isinstance(platform, TakesForces)
    assert platform.bodies[:3] == ("world", "ball", "box")
    assert platform.weight == pytest.approx(5.3 * 9.81)  # the ball is not the robot's
    point = platform.point(BOX, np.array((0.1, 0.0, 0.0)))
    assert point == pytest.approx(platform.data.xpos[BOX] + (0.1, 0.0, 0.0), abs=1e-6)


def test_without_the_states_there_is_none(build, states_of):
    states = States(standard_states(("a",)))
    assert not set(external_states()) & set(states)
