//! Results as a web page: animation of the robot on its ground, plots of forces and attitude over time, and tables of the certificate.
//!
//! The page is a single file. It loads nothing, and its content security policy forbids network access. Its parts are `page.html`,
//! `page.css`, `scene.js` (3D), `plots.js`, `page.js` and `three.min.js`. The last is the part of three.js 0.187.0 (MIT,
//! `three.LICENSE`) that `three.entry.js` exports, built with
//! `npm install three@0.187.0 esbuild && npx esbuild three.entry.js --bundle --minify --format=iife --global-name=THREE --target=es2020
//! --legal-comments=inline --outfile=three.min.js`. A page has 0.65 MB plus about 30 kB per second of a quadruped's motion.

mod certificate;

use crate::error::{Error, Result};
use crate::gait::Trajectory;
use crate::gait::joints::follow;
use crate::report::ground_mesh::GroundMesh;
use crate::report::samples::{FOOT_COLORS, Sample, Sampler, body_size, foot_names, hips};
use crate::robot::Robot;
use crate::terrain::Terrain;
use crate::verify::Report;
use certificate::Certificate;
use serde::Serialize;

/// Sampling rate, Hz. The page interpolates linearly.
const RATE: f64 = 100.;

/// Largest number of results on a page. Each needs its own WebGL context, and browsers limit their number.
pub const MOST_SCENES: usize = 8;

/// Result to show.
pub struct Scene<'a> {
    /// Name of the result.
    pub name: &'a str,
    /// Motion of the robot.
    pub trajectory: &'a Trajectory,
    /// Robot of the motion.
    pub robot: &'a Robot,
    /// Terrain of the motion.
    pub terrain: &'a Terrain,
    /// Limit on the normal force of a foot used for verification, N.
    pub force_limit: f64,
    /// Limits used for verification and where each came from.
    pub terms: &'a [String],
    /// Certificate of the motion.
    pub report: &'a Report,
    /// Gait and cost, as far as they are known.
    pub about: &'a [String],
}

/// Data of the page.
#[derive(Serialize)]
struct Data<'a> {
    version: &'static str,
    rate: f64,
    colors: [&'static str; FOOT_COLORS.len()],
    results: Vec<ResultData<'a>>,
}

/// Data of a result. Curves are flat arrays with shape `[times][axes]`.
#[derive(Serialize)]
struct ResultData<'a> {
    name: &'a str,
    robot: &'a str,
    terrain: &'a str,
    friction: f64,
    about: &'a [String],
    horizon: f64,
    goal: [f64; 3],
    goal_yaw: f64,
    force_limit: f64,
    weight: f64,
    leg: f64,
    body: [f64; 3],
    times: usize,
    position: Vec<f64>,
    velocity: Vec<f64>,
    angles: Vec<f64>,
    feet: Vec<FootData>,
    ground: GroundMesh,
    certificate: Certificate,
}

/// Data of a foot.
#[derive(Serialize)]
struct FootData {
    name: String,
    nominal: [f64; 3],
    /// Edges of the reach, base frame, m, `[edges][2][axes]`.
    reach: Vec<f64>,
    /// Point at which the drawn leg meets the body, base frame, m.
    hip: [f64; 3],
    /// Number of joints of the leg; 0 if the robot has no joint model.
    joints: usize,
    /// Positions of the joints, base frame, m, `[times][joints][axes]`.
    links: Vec<f64>,
    /// Height of the centre of the foot ball above the contact point, m.
    radius: f64,
    /// Length and width of the sole, m; `null` for a ball or point.
    sole: Option<[f64; 2]>,
    /// Vectors from heel to toe and to the left, unit, world frame; empty without a sole.
    axes: Vec<f64>,
    /// Point at which the force acts, world frame, m; empty without a sole.
    pressure: Vec<f64>,
    position: Vec<f64>,
    force: Vec<f64>,
    normal_force: Vec<f64>,
    friction_use: Vec<Option<f64>>,
    /// Start and end of each stance, s.
    stances: Vec<[f64; 2]>,
    /// Position of each foothold, m, and unit normal of the ground there, world frame.
    footholds: Vec<[f64; 6]>,
}

/// Rounds to 1e-5, finer than the page shows.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

/// Values of all samples as a flat array, rounded.
fn flat<const N: usize>(samples: &[Sample], of: impl Fn(&Sample) -> [f64; N]) -> Vec<f64> {
    samples.iter().flat_map(of).map(rounded).collect()
}

/// Values of all samples that have them as a flat array, rounded.
fn of_soles(samples: &[Sample], of: impl Fn(&Sample) -> Option<Vec<f64>>) -> Vec<f64> {
    samples.iter().filter_map(of).flatten().map(rounded).collect()
}

impl<'a> ResultData<'a> {
    fn new(scene: &'a Scene) -> Result<ResultData<'a>> {
        let Scene { trajectory, robot, terrain, .. } = scene;
        let sampler = Sampler::new(trajectory, robot, terrain)?;
        let samples = sampler.samples(RATE);
        let hips = hips(robot);
        let joints = robot.joints.as_ref().map(|legs| follow(trajectory, robot, terrain, RATE).map(|motion| (legs, motion))).transpose()?;
        let feet = foot_names(robot).into_iter().enumerate().map(|(foot, name)| {
            let stances = sampler.stances(foot);
            let edges = robot.reach.foot(foot).edges().into_iter().flatten();
            let (count, radius, links) = joints.as_ref().map_or((0, 0., Vec::new()), |(legs, motion)| {
                let (leg, first) = (&legs[foot], legs[..foot].iter().map(|leg| leg.chain.len()).sum::<usize>());
                let count = leg.chain.len();
                let anchors = motion.samples.iter().flat_map(|sample| leg.posture(&sample.positions[first..first + count]).anchors);
                (count, leg.radius, anchors.flat_map(|at| [at.x, at.y, at.z].map(rounded)).collect())
            });
            FootData {
                name,
                nominal: robot.nominal_feet[foot],
                reach: edges.flat_map(|at| [0, 1, 2].map(|i| rounded(robot.nominal_feet[foot][i] + at[i]))).collect(),
                hip: hips[foot],
                joints: count,
                links,
                radius,
                sole: robot.sole.map(|sole| [sole.length, sole.width]),
                axes: of_soles(&samples, |s| s.feet[foot].sole.as_ref().map(|sole| sole.axes.concat())),
                pressure: of_soles(&samples, |s| s.feet[foot].sole.as_ref().map(|_| s.feet[foot].force_origin().to_vec())),
                position: flat(&samples, |s| s.feet[foot].position),
                force: flat(&samples, |s| s.feet[foot].force),
                normal_force: flat(&samples, |s| [s.feet[foot].normal_force]),
                friction_use: samples.iter().map(|s| s.feet[foot].friction_use.map(rounded)).collect(),
                stances: stances.iter().map(|s| s.times).collect(),
                footholds: stances
                    .iter()
                    .map(|s| {
                        let ([x, y, z], [nx, ny, nz]) = (s.foothold, s.normal);
                        [x, y, z, nx, ny, nz].map(rounded)
                    })
                    .collect(),
            }
        });
        Ok(ResultData {
            name: scene.name,
            robot: &robot.name,
            terrain: &terrain.name,
            friction: terrain.friction,
            about: scene.about,
            horizon: trajectory.horizon,
            goal: trajectory.base_target,
            goal_yaw: trajectory.yaw_target,
            force_limit: scene.force_limit,
            weight: robot.weight(),
            leg: robot.leg_height(),
            body: body_size(robot),
            times: samples.len(),
            position: flat(&samples, |s| s.base.position),
            velocity: flat(&samples, |s| s.base.velocity),
            angles: flat(&samples, |s| s.base.angles),
            feet: feet.collect(),
            ground: GroundMesh::around(&samples, trajectory.base_target, robot.leg_height(), terrain),
            certificate: Certificate::new(scene, &samples),
        })
    }
}

/// HTML page of one or more results, which share a clock.
///
/// # Errors
/// [`Error::Invalid`] if there are no results or more than [`MOST_SCENES`], or if a motion does not fit its robot.
pub fn page(scenes: &[Scene]) -> Result<String> {
    if scenes.is_empty() || scenes.len() > MOST_SCENES {
        return Err(Error::invalid("results", scenes.len(), format!("1 to {MOST_SCENES}")));
    }
    let results = scenes.iter().map(|scene| ResultData::new(scene).map_err(|e| e.within(scene.name))).collect::<Result<_>>()?;
    let data = Data { version: env!("CARGO_PKG_VERSION"), rate: RATE, colors: FOOT_COLORS, results };
    // The marks occur once and in this order. Inserted text is not searched for marks.
    let parts: [(&str, &str); 6] = [
        ("/*page.css*/", include_str!("page.css")),
        ("/*data*/", &within_script(&serde_json::to_string(&data)?)),
        ("/*three.min.js*/", include_str!("three.min.js")),
        ("/*scene.js*/", include_str!("scene.js")),
        ("/*plots.js*/", include_str!("plots.js")),
        ("/*page.js*/", include_str!("page.js")),
    ];
    let (mut text, mut rest) = (String::new(), include_str!("page.html"));
    for (mark, part) in parts {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        text += before;
        text += part;
        rest = after;
    }
    Ok(text + rest)
}

/// JSON escaped for a `<script>` element: it contains no `<`, `>` or `&`, so that it can neither end the element nor start a comment.
fn within_script(json: &str) -> String {
    json.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026")
}

#[cfg(test)]
mod tests;
