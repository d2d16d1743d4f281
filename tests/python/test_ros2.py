"""Plans and grid maps as messages of ROS 2 in MCAP, with the reader and the writer of mcap-ros2-support."""

import math
import pathlib
from typing import Any, Optional

import cregopt
import numpy as np
import pytest

mcap_reader = pytest.importorskip("mcap.reader")
mcap_writer = pytest.importorskip("mcap.writer")
mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")
mcap_ros2_writer = pytest.importorskip("mcap_ros2.writer")

URDF = pathlib.Path(__file__).parents[1] / "data/quadruped.urdf"
SEPARATOR = "=" * 80
GRID_MAP = f"""std_msgs/Header header
GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{SEPARATOR}
MSG: grid_map_msgs/GridMapInfo
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
{SEPARATOR}
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
{SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{SEPARATOR}
MSG: std_msgs/Float32MultiArray
MultiArrayLayout layout
float32[] data
{SEPARATOR}
MSG: std_msgs/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset
{SEPARATOR}
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""


def decoded(path: pathlib.Path) -> dict[str, list[tuple[float, str, Any]]]:
    """Time, type and content of the messages of each topic."""
    topics: dict[str, list[tuple[float, str, Any]]] = {}
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, decoder_factories=[mcap_ros2.DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            topics.setdefault(channel.topic, []).append((message.log_time / 1e9, schema.name, content))
    return topics


def seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def wxyz(quaternion: Any) -> list[float]:
    return [quaternion.w, quaternion.x, quaternion.y, quaternion.z]


def test_a_plan_is_decoded_with_the_values_of_its_samples(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "plan.mcap"
    gait.trajectory.export(path, "ros2", rate=200.0)
    topics, samples = decoded(path), gait.sample(200.0)
    feet = samples.feet_names
    named = {f"/feet/{foot}/{what}" for foot in feet for what in ("wrench", "contact")}
    # The built-in robot has no joints.
    assert set(topics) == {"/base_trajectory", "/tf"} | named
    ((at, kind, base),) = topics["/base_trajectory"]
    assert (at, kind) == (0.0, "trajectory_msgs/msg/MultiDOFJointTrajectory")
    assert (base.header.frame_id, base.joint_names, len(base.points)) == ("world", ["base"], len(samples))
    linear, angular = [], []
    for i, point in enumerate(base.points):
        assert seconds(point.time_from_start) == pytest.approx(samples.time[i], abs=1e-9)
        (transform,), (velocity,), (acceleration,) = point.transforms, point.velocities, point.accelerations
        assert xyz(transform.translation) == samples.base_position[i].tolist()
        assert wxyz(transform.rotation) == samples.base_quaternion[i].tolist()
        assert xyz(velocity.linear) == samples.base_velocity[i].tolist()
        assert xyz(velocity.angular) == samples.base_angular_velocity[i].tolist()
        linear.append(xyz(acceleration.linear))
        angular.append(xyz(acceleration.angular))
    # Inside a piece of the base curve the acceleration is linear in time, so the trapezoidal rule gives the change of the velocity.
    step = np.diff(samples.time)[:, None]
    for velocities, accelerations in ((samples.base_velocity, np.array(linear)), (samples.base_angular_velocity, np.array(angular))):
        errors = np.diff(velocities, axis=0) - step * (accelerations[1:] + accelerations[:-1]) / 2
        assert np.abs(accelerations).max() > 0.1 and np.median(np.abs(errors)) < 1e-5
    for f, foot in enumerate(feet):
        wrenches, contacts = topics[f"/feet/{foot}/wrench"], topics[f"/feet/{foot}/contact"]
        assert len(wrenches) == len(contacts) == len(samples)
        for i, ((at, kind, wrench), (_, flag, contact)) in enumerate(zip(wrenches, contacts)):
            assert (kind, flag) == ("geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Bool")
            assert wrench.header.frame_id == f"foot_{foot}"
            assert at == pytest.approx(samples.time[i], abs=1e-9) and seconds(wrench.header.stamp) == pytest.approx(at, abs=1e-9)
            assert xyz(wrench.wrench.force) == samples.forces[i, f].tolist() and xyz(wrench.wrench.torque) == [0.0] * 3
            assert contact.data == samples.contacts[i, f]
    for i, (_, kind, transforms) in enumerate(topics["/tf"]):
        assert kind == "tf2_msgs/msg/TFMessage"
        frames = {frame.child_frame_id: frame for frame in transforms.transforms}
        assert set(frames) == {"base"} | {f"foot_{foot}" for foot in feet}
        assert all(frame.header.frame_id == "world" for frame in frames.values())
        assert xyz(frames["base"].transform.translation) == samples.base_position[i].tolist()
        for f, foot in enumerate(feet):
            assert xyz(frames[f"foot_{foot}"].transform.translation) == samples.feet_position[i, f].tolist()


def test_a_robot_with_joints_has_a_joint_trajectory(tmp_path: pathlib.Path) -> None:
    robot = cregopt.Robot.from_urdf(URDF)
    task = cregopt.Task(robot, cregopt.Terrain("flat"), goal=(0.3, 0.0))
    motion = cregopt.search(task, first=True, device="cpu").trajectory
    motion.export(tmp_path / "plan.mcap", "ros2")
    ((_, kind, plan),) = decoded(tmp_path / "plan.mcap")["/joint_trajectory"]
    joints = motion.joints()
    assert kind == "trajectory_msgs/msg/JointTrajectory" and plan.joint_names == list(joints.names)
    assert len(plan.points) == len(joints)
    for i, point in enumerate(plan.points):
        assert seconds(point.time_from_start) == pytest.approx(joints.time[i], abs=1e-9)
        assert list(point.positions) == joints.positions[i].tolist() and list(point.velocities) == joints.velocities[i].tolist()
        assert list(point.effort) == joints.efforts[i].tolist() and list(point.accelerations) == []


def test_unknown_formats_and_rates_are_refused(gait: cregopt.Gait, tmp_path: pathlib.Path) -> None:
    with pytest.raises(cregopt.Error, match="format: unknown variant `bag`.*ros2"):
        gait.trajectory.export(tmp_path / "plan", "bag")  # type: ignore[arg-type]
    with pytest.raises(cregopt.Error, match="rate.*10000"):
        gait.trajectory.export(tmp_path / "plan", "ros2", rate=0.0)
    assert not any(tmp_path.iterdir())


def height(x: float, y: float) -> float:
    return 0.1 * x + 0.02 * math.sin(3.0 * y)


def write_grid_map(path: pathlib.Path, start: tuple[int, int], compression: Any, hole: Optional[tuple[int, int]] = None) -> None:
    """Map of 7 x 4 cells of 0.25 m around (0.5, -1), as `grid_map_ros` writes it."""
    rows, columns, cell, centre = 7, 4, 0.25, (0.5, -1.0)
    matrix = np.full((rows, columns), np.nan)
    for i in range(rows):
        for j in range(columns):
            # Rows and columns run against the axes from the start index.
            x = centre[0] + 0.5 * rows * cell - 0.5 * cell - cell * ((i - start[0]) % rows)
            y = centre[1] + 0.5 * columns * cell - 0.5 * cell - cell * ((j - start[1]) % columns)
            matrix[i, j] = height(x, y)
    if hole:
        matrix[hole] = np.nan
    layout = {
        "dim": [
            {"label": "column_index", "size": columns, "stride": rows * columns},
            {"label": "row_index", "size": rows, "stride": rows},
        ],
        "data_offset": 0,
    }
    message = {
        "header": {"stamp": {"sec": 3, "nanosec": 0}, "frame_id": "odom"},
        "info": {
            "resolution": cell,
            "length_x": rows * cell,
            "length_y": columns * cell,
            "pose": {
                "position": {"x": centre[0], "y": centre[1], "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        },
        "layers": ["elevation", "variance"],
        "basic_layers": ["elevation"],
        "data": [
            {"layout": layout, "data": matrix.flatten(order="F").tolist()},
            {"layout": layout, "data": [0.5] * (rows * columns)},
        ],
        "outer_start_index": start[0],
        "inner_start_index": start[1],
    }
    with path.open("wb") as file:
        writer = mcap_ros2_writer.Writer(file, compression=compression)
        schema = writer.register_msgdef("grid_map_msgs/msg/GridMap", GRID_MAP)
        writer.write_message("/elevation_mapping/elevation_map", schema, message, log_time=3_000_000_000)
        writer.finish()


@pytest.mark.parametrize("start", [(0, 0), (3, 0), (6, 2)])
@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_a_grid_map_has_its_heights_at_their_positions(tmp_path: pathlib.Path, start: tuple[int, int], compression: str) -> None:
    path = tmp_path / "hill.mcap"
    write_grid_map(path, start, mcap_writer.CompressionType[compression])
    terrain = cregopt.Terrain.from_map(path, friction=0.6)
    assert (terrain.name, terrain.friction) == ("hill", 0.6)
    assert terrain.to_dict()["shape"]["grid"]["low"] == [-0.25, -1.375]
    for x in np.arange(-0.25, 1.26, 0.25):
        for y in np.arange(-1.375, -0.62, 0.25):
            assert terrain.height(x, y) == pytest.approx(height(x, y), abs=1e-6)
    assert cregopt.Terrain(str(path)).height(0.5, -1.125) == terrain.height(0.5, -1.125)
    variance = cregopt.Terrain.from_map(path, layer="variance", origin=(0.0, 0.0))
    assert variance.height(0.0, 0.0) == 0.5 and variance.to_dict()["shape"]["grid"]["low"] == [0.0, 0.0]


def test_unknown_cells_are_holes_and_unknown_layers_are_named(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "hill.mcap"
    # The first row has the largest x, the second column the second largest y.
    write_grid_map(path, (0, 0), mcap_writer.CompressionType.NONE, hole=(0, 1))
    terrain = cregopt.Terrain.from_map(path)
    heights = np.array(terrain.to_dict()["shape"]["grid"]["heights"])
    assert np.argwhere(heights < heights.max() - 1.0).tolist() == [[6, 2]]
    with pytest.raises(cregopt.Error, match="hill.mcap: .*unknown layer `elevaton`; did you mean `elevation`"):
        cregopt.Terrain.from_map(path, layer="elevaton")
    with pytest.raises(cregopt.Error, match="resolution of the map is 0.25 m"):
        cregopt.Terrain.from_map(path, cell=0.1)
