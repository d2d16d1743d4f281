//! Motions as MCAP files with Foxglove's schemas. Topics, frames and signs: [`super`].
//!
//! `foxglove/*.json` are Foxglove's JSON Schemas (MIT, `foxglove/LICENSE`).

use super::log::Log;
use super::{NO_TURN, Sampled, frame_name, turn_of};
use crate::error::Result;
use crate::gait::Trajectory;
use crate::report::ground_mesh::GroundMesh;
use crate::report::samples::{FOOT_COLORS, Sample, Sampler, body_size, hips};
use crate::robot::Robot;
use crate::terrain::Terrain;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::{Value, json};

/// Topics, each with the name and the text of its schema.
fn topics() -> [(&'static str, &'static str, String); 3] {
    [
        ("/tf", "foxglove.FrameTransforms", include_str!("foxglove/FrameTransforms.json").into()),
        ("/scene", "foxglove.SceneUpdate", include_str!("foxglove/SceneUpdate.json").into()),
        ("/motion", "cregopt.Motion", motion_schema().to_string()),
    ]
}

/// Bytes of the MCAP file of a motion.
///
/// # Errors
/// * [`crate::Error::Invalid`] if the trajectory is malformed, or robot and trajectory disagree on the number of feet
/// * [`crate::Error::Format`] if the MCAP library cannot write
pub fn mcap(sampled: &Sampled, trajectory: &Trajectory, robot: &Robot, terrain: &Terrain) -> Result<Vec<u8>> {
    let mut log = Log::new("")?;
    let mut channels = Vec::new();
    for (topic, name, schema) in topics() {
        channels.push(log.channel(topic, [name, "jsonschema", &schema], "json")?);
    }
    let scene = Drawing { sampled, robot };
    let sampler = Sampler::new(trajectory, robot, terrain)?;
    for (sequence, sample) in (0u32..).zip(&sampled.samples) {
        let mut entities = vec![scene.robot(sample)];
        if sequence == 0 {
            let ground = GroundMesh::around(&sampled.samples, trajectory.base_target, robot.leg_height(), terrain);
            entities.extend([scene.ground(&ground), scene.plan(&sampler)]);
        }
        let messages = [scene.transforms(sample), json!({"deletions": [], "entities": entities}), scene.motion(sample)];
        for (&channel, message) in channels.iter().zip(messages) {
            log.add(channel, sequence, sample.time, &serde_json::to_vec(&message)?)?;
        }
    }
    log.finish()
}

/// Source of the messages of a motion.
struct Drawing<'a> {
    sampled: &'a Sampled,
    robot: &'a Robot,
}

fn xyz([x, y, z]: [f64; 3]) -> Value {
    json!({"x": x, "y": y, "z": z})
}

fn rotation([w, x, y, z]: [f64; 4]) -> Value {
    json!({"w": w, "x": x, "y": y, "z": z})
}

fn pose(position: [f64; 3], turn: [f64; 4]) -> Value {
    json!({"position": xyz(position), "orientation": rotation(turn)})
}

fn time(seconds: f64) -> Value {
    let nanoseconds = (seconds * 1e9).round() as u64;
    json!({"sec": nanoseconds / 1_000_000_000, "nsec": nanoseconds % 1_000_000_000})
}

/// Foxglove colour from `#rrggbb` and an opacity.
fn color(hex: &str, a: f64) -> Value {
    let part = |i: usize| hex.get(i..i + 2).and_then(|s| u8::from_str_radix(s, 16).ok()).map_or(0., |v| f64::from(v) / 255.);
    json!({"r": part(1), "g": part(3), "b": part(5), "a": a})
}

/// Quaternion w, x, y, z of a rotation that turns the x axis into a direction.
fn along(direction: Vector3<f64>) -> [f64; 4] {
    // The direction -x has many such rotations. Any of them is suitable.
    let turn = UnitQuaternion::rotation_between(&Vector3::x(), &direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
    [turn.w, turn.i, turn.j, turn.k]
}

/// Scene entity in the world frame, which is shown until an entity with the same id replaces it.
fn entity(id: &str, at: f64, shapes: Value) -> Value {
    let mut entity = json!({
        "timestamp": time(at), "frame_id": "world", "id": id, "lifetime": time(0.), "frame_locked": false, "metadata": [],
        "arrows": [], "cubes": [], "spheres": [], "cylinders": [], "lines": [], "triangles": [], "texts": [], "models": []
    });
    if let (Value::Object(entity), Value::Object(shapes)) = (&mut entity, shapes) {
        entity.extend(shapes);
    }
    entity
}

/// Foxglove's code for line strips.
const STRIP: u8 = 0;

impl Drawing<'_> {
    fn transforms(&self, sample: &Sample) -> Value {
        let frame = |name: String, position, turn| {
            json!({
                "timestamp": time(sample.time), "parent_frame_id": "world", "child_frame_id": name,
                "translation": xyz(position), "rotation": rotation(turn)
            })
        };
        let feet = sample.feet.iter().zip(&self.sampled.names).map(|(foot, name)| frame(frame_name(name), foot.position, turn_of(foot)));
        let base = frame("base".into(), sample.base.position, sample.base.quaternion);
        json!({"transforms": std::iter::once(base).chain(feet).collect::<Vec<_>>()})
    }

    /// Entity with body, legs, feet and forces.
    fn robot(&self, sample: &Sample) -> Value {
        let leg = self.robot.leg_height();
        let [w, x, y, z] = sample.base.quaternion;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let base = Vector3::from(sample.base.position);
        let (mut legs, mut balls, mut arrows, mut cubes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (i, (foot, hip)) in sample.feet.iter().zip(hips(self.robot)).enumerate() {
            let hip = base + turn * Vector3::from(hip);
            legs.push(json!({
                "type": STRIP, "pose": pose([0.; 3], NO_TURN), "thickness": 0.08 * leg, "scale_invariant": false,
                "points": [xyz(hip.into()), xyz(foot.position)], "color": color(FOOT_COLORS[i], 1.), "colors": [], "indices": []
            }));
            let shape =
                |size: [f64; 3]| json!({"pose": pose(foot.position, turn_of(foot)), "size": xyz(size), "color": color(FOOT_COLORS[i], 1.)});
            match self.robot.sole {
                Some(sole) => cubes.push(shape([sole.length, sole.width, 0.03 * leg])),
                None => balls.push(shape([0.15 * leg; 3])),
            }
            let force = Vector3::from(foot.force);
            // An arrow as long as two legs is the robot's weight.
            let length = 2. * leg * force.norm() / self.robot.weight();
            if foot.stance && length > 0.02 * leg {
                let head = (0.2 * leg).min(length);
                arrows.push(json!({
                    "pose": pose(foot.force_origin(), along(force)), "shaft_length": length - head, "shaft_diameter": 0.05 * leg,
                    "head_length": head, "head_diameter": 0.12 * leg, "color": color(FOOT_COLORS[i], 0.9)
                }));
            }
        }
        let body = json!({"pose": pose(sample.base.position, sample.base.quaternion), "size": xyz(body_size(self.robot)), "color": color("#b9c5d1", 0.9)});
        cubes.insert(0, body);
        entity("robot", sample.time, json!({"cubes": cubes, "lines": legs, "spheres": balls, "arrows": arrows}))
    }

    fn ground(&self, mesh: &GroundMesh) -> Value {
        let across = mesh.ys.len();
        let points: Vec<Value> =
            mesh.heights.iter().enumerate().map(|(i, &z)| xyz([mesh.xs[i / across], mesh.ys[i % across], z])).collect();
        let mut indices = Vec::new();
        for i in 0..mesh.xs.len() - 1 {
            for j in 0..across - 1 {
                let (a, b) = (i * across + j, (i + 1) * across + j);
                indices.extend([a, b, b + 1, a, b + 1, a + 1]);
            }
        }
        let triangles = json!({
            "pose": pose([0.; 3], NO_TURN), "points": points, "color": color("#d9dee4", 1.), "colors": [], "indices": indices
        });
        entity("ground", 0., json!({"triangles": [triangles]}))
    }

    /// Entity with the path of the base and the footholds.
    fn plan(&self, sampler: &Sampler) -> Value {
        let leg = self.robot.leg_height();
        let points: Vec<Value> = self.sampled.samples.iter().map(|s| xyz(s.base.position)).collect();
        let path = json!({
            "type": STRIP, "pose": pose([0.; 3], NO_TURN), "thickness": 2., "scale_invariant": true,
            "points": points, "color": color("#33475b", 1.), "colors": [], "indices": []
        });
        let discs: Vec<Value> = (0..sampler.feet())
            .flat_map(|foot| sampler.stances(foot).into_iter().map(move |stance| (foot, stance)))
            .map(|(foot, stance)| {
                let up = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::from(stance.normal)).unwrap_or_default();
                json!({
                    "pose": pose(stance.foothold, [up.w, up.i, up.j, up.k]), "size": xyz([0.22 * leg, 0.22 * leg, 0.01 * leg]),
                    "bottom_scale": 1., "top_scale": 1., "color": color(FOOT_COLORS[foot], 0.6)
                })
            })
            .collect();
        entity("plan", 0., json!({"lines": [path], "cylinders": discs}))
    }

    fn motion(&self, sample: &Sample) -> Value {
        let base = &sample.base;
        let [roll, pitch, yaw] = base.angles;
        let feet: serde_json::Map<String, Value> = sample
            .feet
            .iter()
            .zip(&self.sampled.names)
            .map(|(foot, name)| {
                let mut value = json!({
                    "position": xyz(foot.position), "velocity": xyz(foot.velocity), "force": xyz(foot.force), "contact": foot.stance,
                    "normal_force": foot.normal_force, "friction_use": foot.friction_use
                });
                if let Some(sole) = &foot.sole {
                    (value["moment"], value["yaw"]) = (xyz(sole.moment), json!(sole.yaw()));
                }
                (name.clone(), value)
            })
            .collect();
        json!({
            "time": sample.time,
            "base": {
                "position": xyz(base.position), "orientation": rotation(base.quaternion), "roll": roll, "pitch": pitch, "yaw": yaw,
                "velocity": xyz(base.velocity), "angular_velocity": xyz(base.angular_velocity)
            },
            "feet": feet
        })
    }
}

/// JSON Schema of `/motion`.
fn motion_schema() -> Value {
    let number = |about: &str| json!({"type": "number", "description": about});
    let vector = |about: &str| {
        let parts: serde_json::Map<String, Value> =
            ["x", "y", "z"].map(|axis| (axis.to_owned(), json!({"type": "number"}))).into_iter().collect();
        json!({"type": "object", "description": about, "properties": parts, "required": ["x", "y", "z"]})
    };
    let foot = json!({
        "type": "object",
        "properties": {
            "position": vector("world frame, m"), "velocity": vector("world frame, m/s"),
            "force": vector("of the ground on the foot, world frame, N"),
            "moment": vector("of the ground on a sole about its centre, world frame, N m; absent for other feet"),
            "yaw": number("of a sole, world frame, rad; absent for other feet"),
            "contact": {"type": "boolean", "description": "true in stance"},
            "normal_force": number("along the normal of the ground, N"),
            "friction_use": {"type": ["number", "null"], "description": "|t.f| / (mu n.f); null if the foot carries almost no load"}
        },
        "required": ["position", "velocity", "force", "contact", "normal_force"]
    });
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "cregopt.Motion",
        "type": "object",
        "properties": {
            "time": number("s"),
            "base": {
                "type": "object",
                "properties": {
                    "position": vector("centre of mass, world frame, m"),
                    "orientation": {
                        "type": "object", "description": "base to world",
                        "properties": {"w": number(""), "x": number(""), "y": number(""), "z": number("")},
                        "required": ["w", "x", "y", "z"]
                    },
                    "roll": number("rad"), "pitch": number("rad"), "yaw": number("rad"),
                    "velocity": vector("world frame, m/s"), "angular_velocity": vector("world frame, rad/s")
                },
                "required": ["position", "orientation", "roll", "pitch", "yaw", "velocity", "angular_velocity"]
            },
            "feet": {"type": "object", "additionalProperties": foot}
        },
        "required": ["time", "base", "feet"]
    })
}
