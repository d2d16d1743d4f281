"""Planning online: states, plans and updates."""

from typing import Any, Optional

import cregopt
import numpy as np
import pytest
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROBOT = cregopt.Robot("anymal")
FLAT = cregopt.Terrain("flat")
HEIGHT = float(ROBOT.to_dict()["base_height"])
#: Trotting or standing, for tests in which the choice does not matter.
QUICK: dict[str, Any] = {"families": ["trot"], "change_durations": False}


def matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Rotation about x, then y, then z."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(about_z @ about_y @ about_x)


def of_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrix of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def parts(yaw: float = 0.0, **changed: Any) -> dict[str, Any]:
    """Arguments of the state of a robot that stands at the origin, with some of them changed."""
    feet = ROBOT.nominal_feet @ matrix(0, 0, yaw).T + [0, 0, HEIGHT]
    feet[:, 2] = 0
    still = {"velocity": np.zeros(3), "angular_velocity": np.zeros(3), "feet_velocity": 0 * feet, "contacts": [True] * 4}
    return {"position": [0, 0, HEIGHT], "rotation": matrix(0, 0, yaw), "feet": feet, **still, **changed}


def standing(yaw: float = 0.0) -> cregopt.RobotState:
    return cregopt.RobotState(**parts(yaw))


def planned(plan: cregopt.Plan, time: float) -> cregopt.RobotState:
    """State of a robot that follows a plan exactly, at a time on the clock of the updates."""
    samples = plan.sample(rate=500)
    k = min(round((time - plan.start) * 500), len(samples) - 1)
    return cregopt.RobotState(
        samples.base_position[k],
        of_quaternion(samples.base_quaternion[k]),
        samples.base_velocity[k],
        samples.base_angular_velocity[k],
        samples.feet_position[k],
        samples.feet_velocity[k],
        samples.contacts[k],
    )


def planner(settings: Optional[dict[str, Any]] = None) -> cregopt.Planner:
    return cregopt.Planner(ROBOT, FLAT, settings)


def test_an_update_gives_a_plan_from_the_state() -> None:
    update = planner().update(standing(), (0.5, 0.0, 0.0), now=3.0)
    assert update.renewed and 0 < update.solved <= update.candidates == 16
    assert update.iterations > 0 and update.seconds > 0
    plan = update.plan
    assert plan.start == 3.0 and plan.horizon == pytest.approx(0.8) and np.isfinite(plan.cost)
    assert plan.gait in {"walk", "trot", "pace", "bound", "canter", "rotary-gallop", "transverse-gallop", "pronk", None}
    swing, stance, phase = plan.cycle
    assert 0 < swing < 1 and 0 < stance < 2 and 0 <= phase < 1
    assert len(plan.schedule) == 4
    assert [sum(durations) for durations in plan.schedule] == pytest.approx([plan.horizon] * 4)
    # It accelerates to the command.
    samples = plan.sample()
    assert samples.base_velocity[0] == pytest.approx([0, 0, 0]) and samples.base_velocity[-1, 0] > 0.3


def test_samples_start_at_the_state_and_end_at_the_horizon() -> None:
    plan = planner(QUICK).update(standing(), (0.6, 0.0, 0.0), now=0.0).plan
    for rate in (50.0, 500.0):
        samples = plan.sample(rate=rate)
        assert len(samples) == round(rate * plan.horizon) + 1
        assert samples.time[0] == 0 and samples.time[-1] == pytest.approx(plan.horizon)
    assert samples.base_position[0] == pytest.approx([0, 0, HEIGHT])
    assert np.allclose(samples.feet_position[0], parts()["feet"], atol=1e-6)
    assert samples.forces.shape == samples.feet_position.shape == (len(samples), 4, 3)
    assert samples.contacts.any(axis=0).all() and not samples.contacts.all()
    assert np.abs(samples.forces[~samples.contacts]).max() < 1e-6
    with pytest.raises(cregopt.Error):
        plan.sample(rate=0)


def test_plans_hold_by_the_certificate_and_are_trajectories() -> None:
    by = planner()
    plan = by.update(standing(), (0.4, 0.1, 0.2), now=0.0).plan
    # The second plan starts in motion, with feet in the air.
    for now in (0.16, 0.3):
        plan = by.update(planned(plan, now), (0.4, 0.1, 0.2), now).plan
        assert plan.start == now
        certificate = cregopt.verify(plan.trajectory)
        assert certificate.feasible, str(certificate)
    assert any(durations[0] == 0 for durations in plan.schedule)
    described = plan.trajectory.to_dict()
    again = cregopt.Trajectory.from_dict(described)
    assert again.to_dict() == described and cregopt.verify(again).feasible
    assert again.schedule == plan.schedule
    assert np.array_equal(again.sample(rate=100).forces, plan.sample(rate=100).forces)


def test_a_plan_starts_with_the_attitude_and_the_angular_velocity_of_the_state() -> None:
    for roll, pitch, yaw in [(0.0, 0.0, 2.0), (0.05, -0.04, 2.0), (-0.06, 0.05, -3.1)]:
        rotation = matrix(roll, pitch, yaw)
        # Lower than it stands, so that the legs reach the ground when it leans.
        given = parts(yaw, position=[0, 0, 0.9 * HEIGHT], rotation=rotation, velocity=[0.1, -0.05, 0.02], angular_velocity=[0.2, -0.15, 0.3])
        update = planner().update(cregopt.RobotState(**given), (0.0, 0.0, 0.0), now=0.0)
        samples = update.plan.sample()
        assert np.allclose(of_quaternion(samples.base_quaternion[0]), rotation, atol=1e-6)
        assert samples.base_angles[0] == pytest.approx([roll, pitch, yaw], abs=1e-6)
        assert samples.base_angular_velocity[0] == pytest.approx([0.2, -0.15, 0.3], abs=1e-6)
        assert samples.base_velocity[0] == pytest.approx([0.1, -0.05, 0.02], abs=1e-6)
        assert np.allclose(samples.feet_position[0], given["feet"], atol=1e-6)


def test_a_foot_in_the_air_continues_its_swing() -> None:
    feet, velocity = parts()["feet"], np.zeros((4, 3))
    feet[0, 2], velocity[0] = 0.05, [0.4, 0.0, 0.0]
    given = parts(feet=feet, feet_velocity=velocity, contacts=[False, True, True, True])
    plan = planner().update(cregopt.RobotState(**given), (0.2, 0.0, 0.0), now=0.0).plan
    samples = plan.sample()
    assert plan.schedule[0][0] == 0 and all(durations[0] > 0 for durations in plan.schedule[1:])
    assert samples.contacts[0].tolist() == [False, True, True, True]
    assert samples.feet_position[0, 0] == pytest.approx(feet[0], abs=1e-6)
    assert samples.feet_velocity[0, 0] == pytest.approx(velocity[0], abs=1e-6)


def test_commands_are_in_the_axes_of_the_base() -> None:
    # To the left of a robot with this yaw is (-sin 2, cos 2).
    left = planner(QUICK).update(standing(2.0), (0.0, 0.2, 0.0), now=0.0).plan.sample()
    moved = left.base_position[-1, :2] - left.base_position[0, :2]
    assert moved @ [-np.sin(2.0), np.cos(2.0)] > 0.05 > abs(moved @ [np.cos(2.0), np.sin(2.0)])
    turned = planner(QUICK).update(standing(2.0), (0.0, 0.0, -0.8), now=0.0).plan.sample()
    assert -0.8 * 0.8 < turned.base_angles[-1, 2] - 2.0 < -0.5 * 0.8 * 0.8
    assert turned.base_angular_velocity[-1, 2] == pytest.approx(-0.8, abs=0.2)


def test_a_robot_turns_in_place_beyond_half_a_turn() -> None:
    by, rate, period = planner(QUICK), 1.2, 0.1
    plan = by.update(standing(2.0), (0.0, 0.0, rate), now=0.0).plan
    yaws, kept = [2.0], 0
    for number in range(1, 41):
        # The rotation matrix of the state gives a yaw within half a turn: it jumps when the robot passes pi.
        update = by.update(planned(plan, number * period), (0.0, 0.0, rate), number * period)
        plan, kept = update.plan, kept + (not update.renewed)
        samples = plan.sample()
        if update.renewed:
            assert abs(samples.base_angles[0, 2]) <= np.pi + 1e-6
            assert np.ptp(samples.base_angles[:, 2]) < 1.5 * rate * plan.horizon
        yaws.append(float(samples.base_angles[0, 2]))
    yaw = np.unwrap(yaws)
    assert kept <= 2
    assert yaw[-1] - yaw[0] == pytest.approx(rate * 4.0, rel=0.1)
    assert np.linalg.norm(samples.base_position[0, :2]) < 0.1


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    plans = []
    for threads in (1, 3):
        by = planner({"threads": threads, "candidates": 8})
        plan = by.update(standing(), (0.4, 0.0, 0.0), now=0.0).plan
        plans.append(by.update(planned(plan, 0.1), (0.4, 0.0, 0.0), now=0.1).plan.trajectory.to_dict())
    assert plans[0] == plans[1]


def test_latency_delays_the_start_of_the_plan() -> None:
    assert planner({**QUICK, "latency": 0.02}).update(standing(), (0.2, 0.0, 0.0), now=1.0).plan.start == pytest.approx(1.02)


def test_the_terrain_can_be_replaced() -> None:
    by = planner(QUICK)
    by.update(standing(), (0.2, 0.0, 0.0), now=0.0)
    grid = cregopt.Terrain.heights(np.zeros((40, 40)), cell=0.1, origin=(-2, -2), friction=0.6)
    by.set_terrain(grid)
    plan = by.update(standing(), (0.2, 0.0, 0.0), now=0.02).plan
    assert plan.trajectory.to_dict()["terrain"] == grid.to_dict()


def test_without_a_candidate_that_holds_the_plan_before_stays() -> None:
    # No leg reaches the ground from here.
    lost = cregopt.RobotState(**parts(position=[0, 0, 3 * HEIGHT]))
    with pytest.raises(cregopt.Error, match=r"state: none of \d+ candidates holds"):
        planner(QUICK).update(lost, (0.0, 0.0, 0.0), now=0.0)
    by = planner(QUICK)
    before = by.update(standing(), (0.2, 0.0, 0.0), now=0.0).plan
    update = by.update(lost, (0.2, 0.0, 0.0), now=0.1)
    assert not update.renewed and update.solved == 0
    assert update.plan.start == before.start == 0.0
    assert update.plan.trajectory.to_dict() == before.trajectory.to_dict()
    # It recovers from the next state that it can plan from.
    assert by.update(planned(before, 0.2), (0.2, 0.0, 0.0), now=0.2).renewed


def test_bad_states_raise_errors_that_name_the_place() -> None:
    by, feet = planner(QUICK), parts()["feet"]
    cases: list[tuple[dict[str, Any], str]] = [
        ({"position": [np.nan, 0, 0.5]}, r"state\.base\.position\[0\]: NaN"),
        ({"velocity": [0, np.inf, 0]}, r"state\.base\.velocity\[1\]: inf"),
        ({"angular_velocity": [0, 0, np.nan]}, r"state\.base\.rates\[2\]: NaN"),
        ({"rotation": np.full((3, 3), np.nan)}, r"state\.base\."),
        ({"rotation": matrix(np.pi, 0, 0)}, r"state\.base\.roll: 3\.14"),
        ({"feet": feet * np.nan}, r"\[0\]\.position\[0\]: NaN"),
        ({"feet": feet[:3]}, r"feet: 3 positions, 4 velocities, 4 contacts"),
        ({"contacts": [True] * 5}, r"feet: 4 positions, 4 velocities, 5 contacts"),
        ({"feet": feet[:3], "feet_velocity": 0 * feet[:3], "contacts": [True] * 3}, r"state\.feet: 3 feet, but it must be 4"),
    ]
    for changed, message in cases:
        with pytest.raises(cregopt.Error, match=message):
            by.update(cregopt.RobotState(**parts(**changed)), (0.0, 0.0, 0.0), now=0.0)
    for name, value in [("position", [0, 0]), ("rotation", np.eye(2)), ("feet", feet[:, :2]), ("feet_velocity", np.zeros(12))]:
        with pytest.raises((ValueError, TypeError)):
            cregopt.RobotState(**parts(**{name: value}))
    # They leave the planner as it was.
    assert by.update(standing(), (0.0, 0.0, 0.0), now=0.0).renewed


def test_bad_commands_and_times_raise_errors_that_name_the_place() -> None:
    by = planner(QUICK)
    by.update(standing(), (0.0, 0.0, 0.0), now=1.0)
    cases = [
        ((0.0, np.nan, 0.0), 1.1, r"command\.velocity\[1\]: NaN"),
        ((50.0, 0.0, 0.0), 1.1, r"command\.velocity\[0\]: 50"),
        ((0.0, 0.0, np.inf), 1.1, r"command\.yaw_rate: inf"),
        ((0.0, 0.0, 0.0), np.nan, "now: NaN"),
        ((0.0, 0.0, 0.0), 0.9, "now: 0.9, but it must be a number from 1 "),
    ]
    for command, now, message in cases:
        with pytest.raises(cregopt.Error, match=message):
            by.update(standing(), command, now)


def test_bad_settings_raise_errors_that_name_the_place() -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"horizn": 1.0}, "settings: horizn: unknown field.*did you mean `horizon`"),
        ({"horizon": 99.0}, r"planner\.horizon: 99, but it must be a number from 0\.2 to 10"),
        ({"horizon": "long"}, "settings: horizon"),
        ({"spread": float("nan")}, "settings"),
        ({"families": []}, r"planner\.families"),
        ({"families": ["stroll"]}, r"settings: families\[0\]: unknown variant `stroll`"),
        ({"cost": {"effrt": 1.0}}, r"settings: cost\.effrt"),
    ]
    for settings, message in cases:
        with pytest.raises(cregopt.Error, match=message):
            planner(settings)
