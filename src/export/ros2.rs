//! Motions as MCAP files with messages of ROS 2. Topics, frames and signs: [`super`].

use super::log::Log;
use super::{Sampled, frame_name, turn_of};
use crate::cdr::Writer;
use crate::error::Result;
use crate::gait::Trajectory;
use crate::gait::joints::{JointMotion, follow};
use crate::report::samples::{BaseSample, FootSample, Sample};
use crate::robot::Robot;
use crate::terrain::Terrain;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Fields of the message types by package and name, as `common_interfaces`, `rcl_interfaces` and `geometry2` of ROS 2 define them. Every
/// type follows those that contain it.
const TYPES: [(&str, &str); 15] = [
    ("trajectory_msgs/MultiDOFJointTrajectory", "std_msgs/Header header\nstring[] joint_names\nMultiDOFJointTrajectoryPoint[] points\n"),
    (
        "trajectory_msgs/MultiDOFJointTrajectoryPoint",
        "geometry_msgs/Transform[] transforms\ngeometry_msgs/Twist[] velocities\ngeometry_msgs/Twist[] accelerations\n\
         builtin_interfaces/Duration time_from_start\n",
    ),
    ("trajectory_msgs/JointTrajectory", "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n"),
    (
        "trajectory_msgs/JointTrajectoryPoint",
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start\n",
    ),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    ("geometry_msgs/TransformStamped", "std_msgs/Header header\nstring child_frame_id\nTransform transform\n"),
    ("geometry_msgs/WrenchStamped", "std_msgs/Header header\nWrench wrench\n"),
    ("geometry_msgs/Wrench", "Vector3 force\nVector3 torque\n"),
    ("geometry_msgs/Transform", "Vector3 translation\nQuaternion rotation\n"),
    ("geometry_msgs/Twist", "Vector3 linear\nVector3 angular\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
];

/// Fields of `std_msgs/msg/Bool`, which contains no other type.
const BOOL: &str = "bool data\n";

/// Frame of the ground.
const WORLD: &str = "world";

/// Frame of the body, and the name of its joint to the ground.
const BASE: &str = "base";

/// Definition of a message type with those of all types that it contains, as bags of ROS 2 have it.
fn definition(name: &str) -> String {
    let mut text = String::new();
    let mut needed = vec![name.to_owned()];
    for (known, fields) in TYPES {
        if !needed.iter().any(|name| name == known) {
            continue;
        }
        if known != name {
            text += &format!("{}\nMSG: {known}\n", "=".repeat(80));
        }
        text += fields;
        // A type without a package is of the same package.
        let package = known.split('/').next().unwrap_or_default();
        for kind in fields.lines().filter_map(|line| line.split([' ', '[']).next()) {
            needed.push(if kind.contains('/') { kind.to_owned() } else { format!("{package}/{kind}") });
        }
    }
    text
}

/// Adds a topic of a message type.
fn channel(log: &mut Log, topic: &str, name: &str) -> Result<u16> {
    let text = if name == "std_msgs/Bool" { BOOL.to_owned() } else { definition(name) };
    log.channel(topic, [&name.replacen('/', "/msg/", 1), "ros2msg", &text], "cdr")
}

/// Bytes of the MCAP file of a motion.
///
/// * `rate` - sampling rate of `sampled`, Hz; joints have the same times
///
/// # Errors
/// * [`crate::Error::Invalid`] if the trajectory is malformed, robot and trajectory disagree on the number of feet, or the rate is too low
///   for joints
/// * [`crate::Error::Format`] if the MCAP library cannot write
pub fn ros2(sampled: &Sampled, trajectory: &Trajectory, robot: &Robot, terrain: &Terrain, rate: f64) -> Result<Vec<u8>> {
    let mut log = Log::new("ros2")?;
    let base = channel(&mut log, "/base_trajectory", "trajectory_msgs/MultiDOFJointTrajectory")?;
    log.add(base, 0, 0., &base_trajectory(sampled))?;
    if robot.joints.is_some() {
        let joints = channel(&mut log, "/joint_trajectory", "trajectory_msgs/JointTrajectory")?;
        log.add(joints, 0, 0., &joint_trajectory(&follow(trajectory, robot, terrain, rate)?))?;
    }
    let transforms = channel(&mut log, "/tf", "tf2_msgs/TFMessage")?;
    let mut feet = Vec::new();
    for name in &sampled.names {
        let of = |log: &mut Log, what: &str, kind: &str| channel(log, &format!("/feet/{name}/{what}"), kind);
        feet.push([of(&mut log, "wrench", "geometry_msgs/WrenchStamped")?, of(&mut log, "contact", "std_msgs/Bool")?]);
    }
    for (sequence, sample) in (0..).zip(&sampled.samples) {
        log.add(transforms, sequence, sample.time, &tf(sample, &sampled.names))?;
        for ((foot, name), [wrench, contact]) in sample.feet.iter().zip(&sampled.names).zip(&feet) {
            log.add(*wrench, sequence, sample.time, &foot_wrench(foot, name, sample.time))?;
            let mut message = Writer::new();
            message.bool(foot.stance);
            log.add(*contact, sequence, sample.time, &message.finish())?;
        }
    }
    log.finish()
}

/// Seconds and nanoseconds of a time, s.
fn time(cdr: &mut Writer, seconds: f64) {
    let nanoseconds = (seconds * 1e9).round() as i64;
    cdr.i32((nanoseconds / 1_000_000_000) as i32);
    cdr.u32((nanoseconds % 1_000_000_000) as u32);
}

fn header(cdr: &mut Writer, seconds: f64, frame: &str) {
    time(cdr, seconds);
    cdr.string(frame);
}

fn transform(cdr: &mut Writer, position: [f64; 3], [w, x, y, z]: [f64; 4]) {
    cdr.f64s(&position);
    cdr.f64s(&[x, y, z, w]);
}

/// Sequence of one twist or wrench.
fn one_pair(cdr: &mut Writer, pair: [[f64; 3]; 2]) {
    cdr.sequence([pair].into_iter(), |cdr, pair| cdr.f64s(pair.as_flattened()));
}

fn base_trajectory(sampled: &Sampled) -> Vec<u8> {
    let mut cdr = Writer::new();
    header(&mut cdr, 0., WORLD);
    cdr.sequence([BASE].into_iter(), Writer::string);
    cdr.sequence(sampled.samples.iter(), |cdr, sample| {
        let BaseSample { position, quaternion, velocity, angular_velocity, acceleration, angular_acceleration, .. } = sample.base;
        cdr.sequence([position].into_iter(), |cdr, position| transform(cdr, position, quaternion));
        one_pair(cdr, [velocity, angular_velocity]);
        one_pair(cdr, [acceleration, angular_acceleration]);
        time(cdr, sample.time);
    });
    cdr.finish()
}

fn joint_trajectory(motion: &JointMotion) -> Vec<u8> {
    let mut cdr = Writer::new();
    header(&mut cdr, 0., BASE);
    cdr.sequence(motion.joints.iter(), |cdr, joint| cdr.string(&joint.name));
    cdr.sequence(motion.samples.iter(), |cdr, sample| {
        for values in [&sample.positions, &sample.velocities, &Vec::new(), &sample.efforts] {
            cdr.sequence(values.iter(), |cdr, value| cdr.f64s(&[*value]));
        }
        time(cdr, sample.time);
    });
    cdr.finish()
}

fn tf(sample: &Sample, names: &[String]) -> Vec<u8> {
    let feet = sample.feet.iter().zip(names).map(|(foot, name)| (frame_name(name), foot.position, turn_of(foot)));
    let frames: Vec<_> = std::iter::once((BASE.into(), sample.base.position, sample.base.quaternion)).chain(feet).collect();
    let mut cdr = Writer::new();
    cdr.sequence(frames.into_iter(), |cdr, (frame, position, turn)| {
        header(cdr, sample.time, WORLD);
        cdr.string(&frame);
        transform(cdr, position, turn);
    });
    cdr.finish()
}

/// Wrench of the ground on a foot in the axes of its frame.
fn foot_wrench(foot: &FootSample, name: &str, seconds: f64) -> Vec<u8> {
    let [w, x, y, z] = turn_of(foot);
    let to_foot = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).inverse();
    let moment = foot.sole.as_ref().map_or([0.; 3], |sole| sole.moment);
    let mut cdr = Writer::new();
    header(&mut cdr, seconds, &frame_name(name));
    [foot.force, moment].into_iter().for_each(|vector| cdr.f64s((to_foot * Vector3::from(vector)).as_slice()));
    cdr.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With the feature `import` a reader of CDR exists.
    #[cfg(feature = "import")]
    #[test]
    fn the_wrench_of_a_sole_is_in_the_axes_of_its_frame() {
        use crate::cdr::Reader;
        use crate::report::samples::SoleSample;
        // A sole with its toe along y of the world, on a wall: its left is z, its normal x.
        let sole = SoleSample { moment: [1., 2., 3.], axes: [[0., 1., 0.], [0., 0., 1.]], pressure: None };
        let foot = FootSample {
            position: [0.; 3],
            velocity: [0.; 3],
            stance: true,
            force: [70., 10., -5.],
            normal_force: 70.,
            friction_use: None,
            sole: Some(sole),
        };
        let bytes = foot_wrench(&foot, "L", 1.25);
        let mut cdr = Reader::new(&bytes).unwrap();
        assert_eq!((cdr.i32("").unwrap(), cdr.u32("").unwrap(), cdr.string("").unwrap()), (1, 250_000_000, "foot_L".into()));
        for expected in [10., -5., 70., 2., 3., 1.] {
            assert!((cdr.f64("").unwrap() - expected).abs() < 1e-12);
        }
        let point = foot_wrench(&FootSample { sole: None, ..foot }, "L", 0.);
        let mut cdr = Reader::new(&point).unwrap();
        assert_eq!((cdr.i32("").unwrap(), cdr.u32("").unwrap(), cdr.string("").unwrap()), (0, 0, "foot_L".into()));
        assert_eq!([0; 6].map(|_| cdr.f64("").unwrap()), [70., 10., -5., 0., 0., 0.]);
    }

    #[test]
    fn a_definition_contains_every_type_that_it_uses_once() {
        for (name, _) in TYPES {
            let text = definition(name);
            let types: Vec<&str> = std::iter::once(name).chain(text.lines().filter_map(|line| line.strip_prefix("MSG: "))).collect();
            let parts: Vec<&str> = text.split(&format!("{}\n", "=".repeat(80))).collect();
            assert_eq!(parts.len(), types.len());
            let mut distinct = types.clone();
            distinct.sort_unstable();
            distinct.dedup();
            assert_eq!(distinct.len(), types.len(), "{text}");
            for (part, of) in parts.iter().zip(&types) {
                for line in part.lines().filter(|line| !line.starts_with("MSG: ")) {
                    let kind = line.split([' ', '[']).next().unwrap();
                    let package = of.split('/').next().unwrap();
                    let whole = if kind.contains('/') { kind.to_owned() } else { format!("{package}/{kind}") };
                    let simple = ["bool", "int32", "uint32", "float64", "string"].contains(&kind);
                    assert!(simple || types.contains(&whole.as_str()), "{of} uses {kind}:\n{text}");
                }
            }
        }
    }
}
