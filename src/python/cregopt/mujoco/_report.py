"""Result of playing a plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Optional, Protocol

import numpy as np

#: Largest position error, m, and attitude error, rad, of the base with which a plan counts as followed.
FOLLOWED_POSITION, FOLLOWED_ATTITUDE = 0.1, float(np.radians(15.0))


class MotorLoads(Protocol):
    """Part of a report that concerns the motors and the disturbances; attributes as in :class:`Report`."""

    friction: float
    seed: Optional[int]
    torque_share: float
    torque_joint: str
    joint_speed: float
    joint_speed_limit: float
    speed_joint: str
    unsolved: int
    notes: list[str]


@dataclass
class Report:
    """Result of playing a plan, including the standing before and after it, if it begins and ends at rest.

    World frame, SI units, angles in rad. The base is the centre of mass with the attitude of the model's first body.

    Attributes
    ----------
    model, mass, planned_mass : str, float, float
        Name of the model, its mass, kg, and the mass of the plan's robot, kg.
    friction, planned_friction : float
        Friction coefficients of the ground in the simulation and in the plan.
    seed : int or None
        Seed of the disturbances of start, masses and friction, or None if there were no disturbances.
    horizon : float
        Duration of the plan, s.
    upright, fall_time, fall : bool, float or None, str or None
        True if the robot did not fall; otherwise the time of the fall in the plan's time, s (negative: before the plan started), and its description.
    position_error_max, position_error_rms : float
        Distance of the base from the plan, m.
    attitude_error_max, attitude_error_rms : float
        Angle between the attitudes of the base and the plan, rad.
    end_error : float
        Horizontal distance of the base from the end of the plan, in the last state, m.
    slip_total, slip_max : float
        Distances that loaded feet slid: sum over all stances, and largest of a stance, m.
    missing_contact : float
        Share of the planned stance time in which the feet carried no load.
    torque_share, torque_joint, torque_saturated : float, str, float
        Largest torque as a share of the motor's limit, its joint, and share of time in which at least one motor was saturated.
    joint_speed, joint_speed_limit, speed_joint : float, float, str
        Largest joint speed, rad/s, speed limit of the motors, rad/s, and joint with the largest speed.
    unsolved : int
        Number of control periods in which the quadratic program had no solution.
    notes : list of str
        Remarks on the model or the plan.
    """

    model: str
    mass: float
    planned_mass: float
    friction: float
    planned_friction: float
    seed: Optional[int]
    horizon: float
    upright: bool = True
    fall_time: Optional[float] = None
    fall: Optional[str] = None
    position_error_max: float = 0.0
    position_error_rms: float = 0.0
    attitude_error_max: float = 0.0
    attitude_error_rms: float = 0.0
    end_error: float = 0.0
    slip_total: float = 0.0
    slip_max: float = 0.0
    missing_contact: float = 0.0
    torque_share: float = 0.0
    torque_joint: str = ""
    torque_saturated: float = 0.0
    joint_speed: float = 0.0
    joint_speed_limit: float = 0.0
    speed_joint: str = ""
    unsolved: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def followed(self) -> bool:
        """True if the robot did not fall, and its base was never more than 0.1 m or 15 degrees off the plan."""
        return self.upright and self.position_error_max <= FOLLOWED_POSITION and self.attitude_error_max <= FOLLOWED_ATTITUDE

    def to_dict(self) -> dict[str, Any]:
        """All attributes and ``followed``, for JSON."""
        return {**asdict(self), "followed": self.followed}

    @property
    def outcome(self) -> str:
        """End of the motion: upright or fallen, on the plan or off it."""
        if not self.upright:
            return f"falls at {self.fall_time:.2f} s: {self.fall}"
        return f"upright to the end, {'on' if self.followed else 'off'} the plan"

    @property
    def errors(self) -> str:
        """Distance of the base from the plan."""
        return (
            f"off by at most {self.position_error_max:.3f} m and {np.degrees(self.attitude_error_max):.1f} deg, "
            f"rms {self.position_error_rms:.3f} m and {np.degrees(self.attitude_error_rms):.1f} deg"
        )

    def __str__(self) -> str:
        disturbed = "" if self.seed is None else f", disturbed by seed {self.seed}"
        lines = [
            f"{self.model}: {self.outcome}",
            f"  plan      {self.horizon:.2f} s, {self.planned_mass:.2f} kg, friction {self.planned_friction:g}",
            f"  played    {self.mass:.2f} kg, friction {self.friction:.3g}{disturbed}",
            f"  base      {self.errors}; ends {self.end_error:.3f} m from the end of the plan",
            f"  feet      slide at most {self.slip_max:.3f} m in a stance, {self.slip_total:.2f} m in total; "
            f"no contact in {100 * self.missing_contact:.0f} % of stances",
            f"  torque    at most {100 * self.torque_share:.0f} % of the limit ({self.torque_joint}), "
            f"at a limit {100 * self.torque_saturated:.1f} % of the time",
            f"  speed     at most {self.joint_speed:.1f} of {self.joint_speed_limit:g} rad/s ({self.speed_joint})",
        ]
        if self.unsolved:
            lines.append(f"  control   no solution in {self.unsolved} periods")
        return "\n".join(lines + [f"  note      {note}" for note in self.notes])


@dataclass
class DriveReport:
    """Result of driving a robot.

    World frame, SI units, angles in rad. Attributes that are not listed are those of :class:`Report`.

    Attributes
    ----------
    seconds : float
        Duration of all commands, s.
    commands, pushes : list of list of float
        Velocity forward and to the left, yaw rate, duration; time, force, duration.
    patches, load : list of list of float, list of float or None
        What planner and controller do not know: friction coefficient of a part of the ground and the range of x that it covers; a mass on the base and
        its place in front and to the left of the centre of mass.
    rate, delay, noise, open_loop : float, float, bool, bool
        Updates per second, delay of the planner, s, and how it gets its state.
    distance : float
        Horizontal distance of the end from the start, m.
    speed_error_rms, turn_error_rms, speed_command_rms : float
        Differences between velocity and command, m/s and rad/s, averaged over 0.4 s, from 1 s after each change of the command and each push on; and
        the commanded speed in the same time. 0 if nothing lasts that long.
    updates, kept, stretched, late : int
        Number of updates, of those that kept the plan before, of those whose plan exceeds the usual limits of the legs, and of those that took longer
        than the time between updates. The simulation waits for them: plans come into force after the delay, however long the update took.
    ms_median, ms_99 : float
        Durations of updates, ms: median and 99th percentile.
    gaits : list of [float, str]
        Times at which the gait changed, s, and its family, or ``stand``.
    """

    model: str
    mass: float
    friction: float
    seed: Optional[int]
    seconds: float
    commands: list[list[float]]
    pushes: list[list[float]]
    joint_speed_limit: float
    patches: list[list[float]] = field(default_factory=list)
    load: Optional[list[float]] = None
    rate: float = 0.0
    delay: float = 0.0
    noise: bool = False
    open_loop: bool = False
    upright: bool = True
    fall_time: Optional[float] = None
    fall: Optional[str] = None
    distance: float = 0.0
    speed_error_rms: float = 0.0
    turn_error_rms: float = 0.0
    speed_command_rms: float = 0.0
    updates: int = 0
    kept: int = 0
    stretched: int = 0
    late: int = 0
    ms_median: float = 0.0
    ms_99: float = 0.0
    gaits: list[list[Any]] = field(default_factory=list)
    torque_share: float = 0.0
    torque_joint: str = ""
    torque_saturated: float = 0.0
    joint_speed: float = 0.0
    speed_joint: str = ""
    unsolved: int = 0
    notes: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """All attributes, for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        end = "upright to the end" if self.upright else f"falls at {self.fall_time:.2f} s: {self.fall}"
        gaits = ", ".join(f"{name} from {time:.2f} s" for time, name in self.gaits[:12]) + (", ..." if len(self.gaits) > 12 else "")
        lines = [
            f"{self.model}: {end}",
            f"  driven    {self.seconds:.2f} s, {len(self.commands)} commands, {len(self.pushes)} pushes, {self.distance:.2f} m from the start",
            f"  speed     off by {self.speed_error_rms:.3f} m/s rms at {self.speed_command_rms:.2f} m/s, turn by {self.turn_error_rms:.3f} rad/s",
            f"  plans     {self.updates} updates at {self.rate:g} Hz, median {self.ms_median:.1f} ms, 99th percentile {self.ms_99:.1f} ms, "
            f"{self.late} late, {self.kept} kept the plan before, {self.stretched} stretched",
            f"  gaits     {gaits}",
            f"  torque    at most {100 * self.torque_share:.0f} % of the limit ({self.torque_joint}), "
            f"at a limit {100 * self.torque_saturated:.1f} % of the time",
            f"  joints    at most {self.joint_speed:.1f} of {self.joint_speed_limit:g} rad/s ({self.speed_joint})",
        ]
        if self.unsolved:
            lines.append(f"  control   no solution in {self.unsolved} periods")
        return "\n".join(lines + [f"  note      {note}" for note in self.notes[:5]])
