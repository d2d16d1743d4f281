//! Imports with results known in closed form, and invalid files.

use super::*;
use crate::robot::leg::PRECISION;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

/// Inertia of a uniform box of mass in kg and full side lengths in m.
fn box_inertia(mass: f64, [x, y, z]: [f64; 3]) -> [f64; 3] {
    [y * y + z * z, x * x + z * z, x * x + y * y].map(|v| mass * v / 12.)
}

fn inertial(origin: &str, mass: f64, [xx, yy, zz]: [f64; 3]) -> String {
    format!(
        "<inertial><origin {origin}/><mass value=\"{mass}\"/><inertia ixx=\"{xx}\" ixy=\"0\" ixz=\"0\" iyy=\"{yy}\" iyz=\"0\" izz=\"{zz}\"/></inertial>"
    )
}

fn joint(name: &str, kind: &str, ends: [&str; 2], inside: &str) -> String {
    let [parent, child] = ends;
    format!("<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>{inside}</joint>")
}

const BALL: &str = "<collision><geometry><sphere radius=\"0.02\"/></geometry></collision>";
const LEGS: [&str; 4] = ["LF", "RF", "LH", "RH"];

/// A quadruped with a base of 10 kg, thighs and calves of 0.25 m, and knees bent backwards. The feet are below their hips at thigh 45 and
/// calf -90 degrees.
fn quadruped(foot: &str) -> String {
    include_str!("../../../tests/data/quadruped.urdf").replace(BALL, foot)
}

/// Configuration with the feet below their hips.
pub fn standing() -> Vec<(String, f64)> {
    let of = |leg: &&str| [(format!("{leg}_pitch"), FRAC_PI_4), (format!("{leg}_knee"), -FRAC_PI_2)];
    LEGS.iter().flat_map(of).collect()
}

fn import(text: &str) -> Result<Imported> {
    Import { configuration: standing(), ..Import::default() }.urdf(text)
}

fn legs(imported: &Imported) -> &[Leg] {
    imported.robot.joints.as_deref().unwrap()
}

fn close(a: &[f64], b: &[f64], within: f64) {
    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= within), "{a:?}, but {b:?}");
}

#[test]
fn mass_centre_and_inertia_agree_with_closed_forms() {
    // A box at the root; a longer box, rotated by 90 degrees about z in its link, on a joint that is rotated by 90 degrees about x. In base
    // axes its sides (a, b, c) become (b, c, a). A massless link between them, held by a fixed joint, changes nothing.
    let (first, second) = ([0.4, 0.2, 0.1], [0.6, 0.3, 0.2]);
    let base = inertial("xyz=\"0.1 0 0\"", 3., box_inertia(3., first));
    let hung = inertial(&format!("xyz=\"0 0.5 0\" rpy=\"0 0 {FRAC_PI_2}\""), 2., box_inertia(2., second));
    let text = format!(
        "<robot name=\"two\"><link name=\"base\">{base}</link><link name=\"bare\"/><link name=\"hung\">{hung}</link>{}{}</robot>",
        joint("hold", "fixed", ["base", "bare"], "<origin xyz=\"0 0 0.3\"/>"),
        joint("turn", "continuous", ["bare", "hung"], &format!("<origin rpy=\"{} 0 0\"/><axis xyz=\"0 0 1\"/>", -FRAC_PI_2)),
    );
    let model = urdf::read(&xml::document(&text, urdf::FORMAT).unwrap()).unwrap();
    let tree = Tree::new(&model).unwrap();
    let frames = tree.frames(&tree.configuration(&[]).unwrap());
    let body = body::composite(frames.iter().zip(&model.links).filter_map(|(f, l)| l.inertial.as_ref().map(|i| (f, i))));
    // The y axis of the hanging link points down in the base frame, so its centre is 0.5 m below the joint.
    let centers = [[0.1, 0., 0.], [0., 0., 0.3 - 0.5]];
    assert_eq!(body.mass, 5.);
    let center: [f64; 3] = std::array::from_fn(|i| (3. * centers[0][i] + 2. * centers[1][i]) / 5.);
    close(body.center.as_slice(), &center, 1e-15);
    let sides = [first, [second[1], second[2], second[0]]];
    let mut expected = [[0.; 3]; 3];
    for ((mass, sides), at) in [3., 2.].into_iter().zip(sides).zip(centers) {
        let (own, d) = (box_inertia(mass, sides), std::array::from_fn::<f64, 3, _>(|i| at[i] - center[i]));
        for r in 0..3 {
            for c in 0..3 {
                let square = if r == c { own[r] + mass * d.iter().map(|v| v * v).sum::<f64>() } else { 0. };
                expected[r][c] += square - mass * d[r] * d[c];
            }
        }
    }
    close(body.inertia.as_slice(), expected.as_flattened(), 1e-12);
    // Rotated by 90 degrees about the joint's axis, y of the base: the box lies along x.
    let frames = tree.frames(&tree.configuration(&[("turn".into(), FRAC_PI_2)]).unwrap());
    let hung = frames[2] * model.links[2].inertial.unwrap().origin;
    close(hung.translation.vector.as_slice(), &[-0.5, 0., 0.3], 1e-15);
}

#[test]
fn feet_forces_and_legs_of_a_quadruped_agree_with_trigonometry() {
    let imported = import(&quadruped(BALL)).unwrap();
    let robot = &imported.robot;
    robot.validate().unwrap();
    assert_eq!((robot.name.as_str(), robot.feet(), imported.robot.foot_radius), ("four", 4, Some(0.02)));
    assert_eq!(imported.feet.iter().map(|f| f.link.as_str()).collect::<Vec<_>>(), ["LF_foot", "RF_foot", "LH_foot", "RH_foot"]);
    assert!(imported.notes[0].contains("`LF_foot`, `RF_foot`, `LH_foot`, `RH_foot`"), "{:?}", imported.notes);
    // Each leg: two rods of 0.4 kg with centres 0.125 and 0.375 m along the leg, the first as far behind the hip as the second is before
    // it.
    let s = FRAC_PI_4.sin();
    let (rods, height) = ([[-0.125 * s, -0.125 * s], [-0.125 * s, -0.375 * s]], 0.5 * s);
    let mass = 10. + 8. * 0.4;
    assert!((robot.mass - mass).abs() < 1e-12);
    let center = [4. * 0.4 * (rods[0][0] + rods[1][0]) / mass, 4. * 0.4 * (rods[0][1] + rods[1][1]) / mass];
    close(&imported.center_of_mass, &[center[0], 0., center[1]], 1e-12);
    assert!((robot.base_height - (height + center[1] + 0.02)).abs() < 1e-12);
    for (foot, (x, y)) in [(0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15)].into_iter().enumerate() {
        close(&imported.feet[foot].frame, &[x - center[0], y, -height - center[1]], 1e-12);
        close(&robot.nominal_feet[foot], &[x - center[0], y, -height - center[1] - 0.02], 1e-12);
    }
    // Only the knee has a lever arm under a vertical force: 0.25 sin 45.
    assert!((robot.force_limit.unwrap() - 30. / (0.25 * s)).abs() < 1e-9);
    // Hip and thigh move the foot along x and y, 0.5 cos 45 below them.
    assert!((imported.foot_speed.unwrap() - 12. * height).abs() < 1e-9);
    let moment: f64 = rods.iter().map(|rod| 0.4 * (rod[0] * rod[0] + rod[1] * rod[1])).sum();
    assert!((robot.leg_mass.unwrap() - moment / (height * height)).abs() < 1e-12);
}

#[test]
fn a_robot_with_a_built_in_name_is_renamed_unless_the_name_was_given() {
    let text = quadruped(BALL).replace("<robot name=\"four\">", "<robot name=\"hyq\">");
    let imported = import(&text).unwrap();
    assert_eq!(imported.robot.name, "hyq-imported");
    assert!(imported.notes.iter().any(|note| note.contains("`hyq` has another mass")), "{:?}", imported.notes);
    let named = |name: &str| Import { name: Some(name.into()), configuration: standing(), ..Import::default() }.urdf(&text);
    assert_eq!(named("four").unwrap().robot.name, "four");
    assert!(named("hyq").unwrap_err().to_string().contains("robot.name: `hyq`"));
}

#[test]
fn every_position_in_a_box_is_reachable_and_boxes_are_large() {
    let imported = import(&quadruped(BALL)).unwrap();
    let boxes: Vec<_> = imported.robot.reach_boxes().collect();
    for (foot, (leg, reach)) in legs(&imported).iter().zip(&boxes).enumerate() {
        let nominal = leg.posture(&leg.nominal());
        let hip = nominal.anchors[0];
        for corner in 0..27 {
            let share = |axis: u32| (corner / 3_usize.pow(axis) % 3) as f64 / 2.;
            let at = |axis: usize| reach.low[axis] + share(axis as u32) * (reach.high[axis] - reach.low[axis]);
            let place = nominal.tip + Vector3::new(at(0), at(1), at(2)) - hip;
            // Law of cosines in the plane of the leg, and the roll of that plane.
            let radius = place.norm();
            let knee = -(std::f64::consts::PI - (1. - radius * radius / (2. * 0.25 * 0.25)).acos());
            let roll = place.y.atan2(-place.z);
            let pitch = (-place.x).atan2(place.y.hypot(place.z)) - knee / 2.;
            let limits = [(roll, -0.6, 0.6), (pitch, -1.5, 2.5), (knee, -2.5, -0.5)];
            assert!(limits.iter().all(|&(v, low, high)| v >= low - 1e-4 && v <= high + 1e-4), "foot {foot}, {corner}: {limits:?}");
        }
        // Left and right mirror each other.
        let (other, sides) = (&boxes[foot ^ 1], [reach.low, reach.high]);
        let mirrored = [[other.low[0], -other.high[1], other.low[2]], [other.high[0], -other.low[1], other.high[2]]];
        close(sides.as_flattened(), mirrored.as_flattened(), 1e-9);
        assert!(reach.widths()[0] > 0.2 && reach.widths()[1] > 0.1 && reach.widths()[2] > 0.1, "{reach:?}");
    }
}

#[test]
fn boxes_cannot_be_extended_on_any_side() {
    let imported = import(&quadruped(BALL)).unwrap();
    for (foot, leg) in legs(&imported).iter().enumerate() {
        let (nominal, reach) = (leg.posture(&leg.nominal()).tip, imported.robot.reach.of(foot));
        let room = reach::room(leg, foot, &imported.robot.nominal_feet);
        for axis in 0..3 {
            for (end, sides) in [reach.low, reach.high].into_iter().enumerate() {
                let longer = sides[axis] + if end == 0 { -0.02 } else { 0.02 };
                let full = if end == 0 { longer < room[axis][0] } else { longer > room[axis][1] };
                let corner = |corner: usize| {
                    let mut place: [f64; 3] = std::array::from_fn(|i| if corner >> i & 1 == 0 { reach.low[i] } else { reach.high[i] });
                    place[axis] = longer;
                    nominal + Vector3::from(place)
                };
                assert!(full || (0..8).any(|c| leg.reach(&corner(c), &leg.nominal()).is_none()), "foot {foot}, axis {axis}, end {end}");
            }
        }
    }
}

#[test]
fn feet_touch_the_ground_with_balls_soles_or_their_frames() {
    let low = |foot: &str| {
        let imported = import(&quadruped(foot)).unwrap();
        let (frame, contact) = (imported.feet[0].frame, imported.robot.nominal_feet[0]);
        (std::array::from_fn::<f64, 3, _>(|i| contact[i] - frame[i]), imported)
    };
    let shape = |origin: &str, shape: &str| format!("<collision><origin {origin}/><geometry>{shape}</geometry></collision>");
    // The calf is rotated by -45 degrees about y: the foot's x axis points forward and up, its z axis up and backward.
    let s = FRAC_PI_4.sin();
    let (offset, imported) = low(&shape("xyz=\"0 0 0.1\"", "<sphere radius=\"0.03\"/>"));
    close(&offset, &[-0.1 * s, 0., 0.1 * s - 0.03], 1e-12);
    assert_eq!((imported.robot.foot_radius, legs(&imported)[0].radius), (Some(0.03), 0.03));
    let (offset, imported) = low("<collision><geometry><mesh filename=\"package://nowhere/foot.stl\"/></geometry></collision>");
    close(&offset, &[0.; 3], 1e-12);
    assert!(
        imported.robot.foot_radius.is_none() && imported.notes.iter().any(|n| n.contains("origin of their frames")),
        "{:?}",
        imported.notes
    );
    // A ball has priority over a lower shape.
    let both = shape("", "<box size=\"0.2 0.2 0.2\"/>") + &shape("", "<sphere radius=\"0.01\"/>");
    close(&low(&both).0, &[0., 0., -0.01], 1e-12);
    // Four balls on a sole, level in this configuration, are a flat foot.
    let ball = |x: f64, y: f64| shape(&format!("xyz=\"{} {y} {}\"", x * s, -x * s), "<sphere radius=\"0.01\"/>");
    let sole = [(0.1, 0.03), (0.1, -0.03), (-0.04, 0.03), (-0.04, -0.03)].map(|(x, y)| ball(x, y)).concat();
    let (offset, imported) = low(&sole);
    close(&offset, &[0., 0., -0.01], 1e-12);
    // A sole ahead of the ankle carries the load at its rear end.
    let ahead = [(0.1, 0.03), (0.1, -0.03), (0.02, 0.03), (0.02, -0.03)].map(|(x, y)| ball(x, y)).concat();
    close(&low(&ahead).0, &[0.02, 0., -0.01], 1e-12);
    assert!(imported.robot.foot_radius.is_none() && imported.notes.iter().any(|n| n.contains("flat feet")), "{:?}", imported.notes);
    // Contact is at the lowest point of a shape: here an edge of a box, and the rims of a cylinder and a capsule.
    close(&low(&shape("", "<box size=\"0.04 0.1 0.02\"/>")).0, &[0., 0., -0.03 * s], 1e-12);
    close(&low(&shape("", "<cylinder radius=\"0.02\" length=\"0.06\"/>")).0, &[0., 0., -(0.03 + 0.02) * s], 1e-12);
    close(&low(&shape("", "<capsule radius=\"0.02\" length=\"0.06\"/>")).0, &[0., 0., -0.03 * s - 0.02], 1e-12);
}

#[test]
fn sensors_beside_a_foot_are_not_feet_and_huge_limits_are_infinite() {
    let sensors =
        "<link name=\"LF_heel\"/>".to_owned() + &joint("LF_sensor", "fixed", ["LF_calf", "LF_heel"], "<origin xyz=\"0 0 -0.27\"/>");
    let text = quadruped(BALL).replace("</robot>", &(sensors + "</robot>")).replacen("upper=\"2.5\"", "upper=\"1e16\"", 1);
    let imported = import(&text).unwrap();
    assert_eq!(imported.feet.iter().map(|f| f.link.as_str()).collect::<Vec<_>>(), ["LF_foot", "RF_foot", "LH_foot", "RH_foot"]);
    assert_eq!(legs(&imported)[0].chain[1].limits, [-1.5, f64::INFINITY]);
}

#[test]
fn joints_rest_at_zero_or_mid_range_and_mimic_joints_follow() {
    let text = quadruped(BALL).replacen("</robot>", "", 1)
        + "<link name=\"arm\"/><link name=\"hand\"/>"
        + &joint(
            "reach",
            "prismatic",
            ["base", "arm"],
            "<axis xyz=\"1 0 0\"/><limit lower=\"0.2\" upper=\"0.4\" effort=\"1\" velocity=\"1\"/>",
        )
        + &joint(
            "grip",
            "revolute",
            ["arm", "hand"],
            "<mimic joint=\"reach\" multiplier=\"2\" offset=\"-0.1\"/><limit effort=\"1\" velocity=\"1\"/>",
        )
        + "</robot>";
    let imported = import(&text).unwrap();
    let value = |name: &str| imported.configuration.iter().find(|(joint, _)| joint == name).unwrap().1;
    close(&[value("LF_roll"), value("LF_knee"), value("reach"), value("grip")], &[0., -FRAC_PI_2, 0.3, 0.5], 1e-12);
}

#[test]
fn a_robot_without_a_configuration_stands_on_bent_legs() {
    let resting = Import::default().urdf(&quadruped(BALL)).unwrap();
    let value = |name: &str| resting.configuration.iter().find(|(joint, _)| joint == name).unwrap().1;
    // Two links of equal length, bent to three quarters of their total length.
    let angle = 0.75f64.acos();
    close(&[value("LF_roll"), value("LF_pitch"), value("LF_knee"), value("RH_knee")], &[0., angle, -2. * angle, -2. * angle], 1e-4);
    let (stands, noted) = (import(&quadruped(BALL)).unwrap(), resting.notes.iter().any(|note| note.contains("legs are bent")));
    assert!(noted && !stands.notes.iter().any(|note| note.contains("legs are bent")));
    for (foot, under) in resting.robot.nominal_feet.iter().zip(&stands.robot.nominal_feet) {
        assert!((foot[0] - under[0]).abs() < 0.01 && (foot[1] - under[1]).abs() < 1e-6, "{foot:?} {under:?}");
    }
    assert!(resting.robot.reach_boxes().all(|reach| reach.widths().iter().all(|&width| width > 0.05)));
}

#[test]
fn legs_may_have_prismatic_joints_and_joints_above_two_feet_are_fixed() {
    let slide = quadruped(BALL).replace(
        "name=\"LF_knee\" type=\"revolute\"><parent link=\"LF_thigh\"/><child link=\"LF_calf\"/><origin xyz=\"0 0 -0.25\"/><axis xyz=\"0 1 0\"/><limit lower=\"-2.5\" upper=\"-0.5\"",
        "name=\"LF_knee\" type=\"prismatic\"><parent link=\"LF_thigh\"/><child link=\"LF_calf\"/><origin xyz=\"0 0 -0.1\"/><axis xyz=\"0 0 -1\"/><limit lower=\"-0.1\" upper=\"0.1\"",
    );
    let mut configuration = standing();
    configuration[0].1 = 0.1;
    configuration[1].1 = 0.;
    let imported = Import { feet: vec!["LF_foot".into(), "RH_foot".into()], configuration, ..Import::default() }.urdf(&slide).unwrap();
    let leg = &legs(&imported)[0];
    assert!(!leg.chain[2].turns && imported.robot.reach.of(0).widths()[2] > 0.1);
    let target = leg.posture(&[0.1, 0.2, 0.05]).tip;
    assert!((leg.posture(&leg.reach(&target, &leg.nominal()).unwrap()).tip - target).norm() <= PRECISION);
    // A waist joint above the two hind legs belongs to the body.
    let waist = "<link name=\"hind\"/>".to_owned()
        + &joint(
            "waist",
            "revolute",
            ["base", "hind"],
            "<axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"9\" velocity=\"9\"/>",
        );
    let mut bent = quadruped(BALL).replace("</robot>", &(waist + "</robot>"));
    for leg in ["LH", "RH"] {
        bent = bent.replace(
            &format!("<parent link=\"base\"/><child link=\"{leg}_hip\"/>"),
            &format!("<parent link=\"hind\"/><child link=\"{leg}_hip\"/>"),
        );
    }
    let bent = import(&bent).unwrap();
    assert!(legs(&bent).iter().all(|leg| leg.chain.len() == 3));
    let mut straight = import(&quadruped(BALL)).unwrap().robot;
    straight.joints = bent.robot.joints.clone();
    assert_eq!(bent.robot, straight);
}

/// Errors of invalid files and options.
#[test]
fn errors_name_the_place_the_value_and_the_limit() {
    let good = quadruped(BALL);
    let check = |text: &str, import: &Import, parts: &[&str]| {
        let error = import.urdf(text).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)) && error.lines().count() == 1 && error.len() < 500, "{parts:?}: {error}");
    };
    let standing = Import { configuration: standing(), ..Import::default() };
    check("", &standing, &["empty"]);
    check(" \n", &standing, &["empty"]);
    check("<robot name=\"x\">", &standing, &["not XML"]);
    check(&good[..good.len() / 2], &standing, &["not XML"]);
    check("<sdf/>", &standing, &["<sdf>", "<robot>"]);
    check("<robot name=\"x\"/>", &standing, &["links", "none", "at least one"]);
    let ring = format!(
        "<robot name=\"x\"><link name=\"a\"/><link name=\"b\"/>{}{}</robot>",
        joint("i", "fixed", ["a", "b"], ""),
        joint("j", "fixed", ["b", "a"], "")
    );
    check(&ring, &standing, &["links that no joint moves", "none", "without loops"]);
    let changes: &[(&str, &str, &[&str])] = &[
        ("<inertial>", "<nothing>", &["not XML"]),
        ("mass value=\"10\"", "mass value=\"heavy\"", &["line 4", "link `base`, <mass>, `value`", "\"heavy\"", "a number"]),
        ("mass value=\"10\"", "mass value=\"NaN\"", &["link `base`, <mass>", "\"NaN\""]),
        ("mass value=\"10\"", "mass value=\"-1\"", &["link `base`, <mass>", "-1", "not negative"]),
        ("mass value=\"10\"", "mass value=\"1e300\"", &["link `base`, <mass>", "1000000000"]),
        ("xyz=\"0 0 -0.125\"", "xyz=\"0 0 x 1\"", &["link `LF_thigh`, <origin>, `xyz`", "\"0 0 x 1\"", "3 numbers"]),
        ("xyz=\"0 0 -0.125\"", "xyz=\"0 0 ${z}\"", &["`xyz`", "${z}", "a number"]),
        ("<parent link=\"base\"/>", "<parent link=\"bass\"/>", &["joint `LF_roll`, parent", "`bass`", "`base`"]),
        ("<child link=\"LF_calf\"/>", "<child link=\"LF_thigh\"/>", &["link `LF_thigh`", "`LF_pitch` and `LF_knee`", "loops"]),
        ("<parent link=\"base\"/>", "<parent link=\"LF_foot\"/>", &["link `LF_hip`", "in a loop"]),
        ("<link name=\"LF_hip\"/>", "<link name=\"LF_hip\"/><link name=\"lost\"/>", &["2: `base`, `lost`", "one, the base"]),
        ("<link name=\"LF_hip\"/>", "<link name=\"LF_hip\"/><link name=\"LF_hip\"/>", &["link `LF_hip`", "twice"]),
        ("type=\"revolute\"", "type=\"ball\"", &["joint `LF_roll`, `type`", "\"ball\"", "revolute"]),
        ("axis xyz=\"1 0 0\"", "axis xyz=\"0 0 0\"", &["joint `LF_roll`, <axis>", "0 0 0", "a direction"]),
        ("lower=\"-0.6\"", "lower=\"0.7\"", &["joint `LF_roll`, <limit>", "0.7", "`upper`, 0.6"]),
        ("<sphere radius=\"0.02\"/>", "<sphere/>", &["link `LF_foot`, <sphere>, `radius`", "missing"]),
        (
            "<axis xyz=\"1 0 0\"/>",
            "<axis xyz=\"1 0 0\"/><mimic joint=\"RF_roll\"/>",
            &["joint `LF_roll`", "follows joint `RF_roll`", "mimic"],
        ),
        ("<axis xyz=\"1 0 0\"/>", "<axis xyz=\"1 0 0\"/><mimic joint=\"RF_rol\"/>", &["joint `LF_roll`, mimic", "`RF_rol`", "`RF_roll`"]),
        ("<axis xyz=\"1 0 0\"/>", "<axis xyz=\"1 0 0\"/><mimic joint=\"LF_roll\"/>", &["joint `LF_roll`, mimic", "loop"]),
        ("name=\"four\"", "name=\"fo\u{200b}ur\"", &["robot.name"]),
    ];
    for (from, to, parts) in changes {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from}");
        check(&text, &standing, parts);
    }
    let massless = good.replace("<inertial>", "<!--").replace("</inertial>", "-->");
    check(&massless, &standing, &["mass of all links", "0 kg", "0 of 17 links"]);
    let asked: &[(&[&str], &str, &[&str])] = &[
        (&["LF_fot"], "", &["feet", "`LF_fot`", "`LF_foot`"]),
        (&["LF_foot", "LF_foot"], "", &["feet", "`LF_foot`", "once"]),
        (&["base"], "", &["foot `base`", "no joint of its own"]),
        (&["a", "b", "c", "d", "e", "f", "g", "h", "i"], "", &["9 named", "at most 8"]),
        (&[], "LF_nee=1", &["configuration", "`LF_nee`", "`LF_knee`"]),
        (&[], "LF_knee=1", &["joint `LF_knee`", "1", "-2.5 to -0.5"]),
        (&[], "LF_knee=-1,LF_knee=-1", &["joint `LF_knee`", "given once"]),
        (&[], "LF_ankle=0", &["joint `LF_ankle`", "fixed"]),
        // The feet are above the base.
        (&["LF_foot"], "LF_pitch=2.5,LF_knee=-0.5", &["above"]),
    ];
    for (feet, values, parts) in asked {
        let import =
            Import { feet: feet.iter().map(|&f| f.into()).collect(), configuration: configuration(values).unwrap(), ..Import::default() };
        check(&good, &import, parts);
    }
    for (text, part) in [("LF_knee", "JOINT=VALUE"), ("LF_knee=far", "`LF_knee=far`"), ("LF_knee=NaN", "joint `LF_knee`")] {
        assert!(configuration(text).unwrap_err().to_string().contains(part), "{text}");
    }
}

#[test]
fn too_many_feet_or_no_feet_are_refused() {
    let base = inertial("", 10., [1.; 3]);
    let rod = inertial("xyz=\"0 0 -0.1\"", 0.1, [0.01; 3]);
    let limit = "<limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>";
    let robot = |legs: usize, z: f64| {
        let leg = |i: usize| {
            let hip = joint(&format!("hip {i}"), "revolute", ["base", &format!("leg {i}")], &format!("<origin xyz=\"0 {i} {z}\"/>{limit}"));
            format!("<link name=\"leg {i}\">{rod}</link>{hip}")
        };
        format!("<robot name=\"x\"><link name=\"base\">{base}</link>{}</robot>", (0..legs).map(leg).collect::<String>())
    };
    let refused = |text: &str| Import::default().urdf(text).unwrap_err().to_string();
    assert!(refused(&robot(9, -0.3)).contains("9 found: `leg 0`"));
    assert!(refused(&robot(0, 0.)).contains("none found"));
    assert!(refused(&robot(2, 0.9)).contains("none found"));
    assert!(refused(&robot(2, -0.3)).contains("reaches 0.0000 m along x with 1 joints"), "{}", refused(&robot(2, -0.3)));
}

#[test]
fn deep_and_long_files_do_not_exhaust_the_stack() {
    let deep = format!("<robot name=\"x\">{}{}</robot>", "<a>".repeat(100_000), "</a>".repeat(100_000));
    assert!(import(&deep).unwrap_err().to_string().contains("links: none"));
    // A chain of joints as long as a file of some megabytes can hold.
    let link = |i: usize| {
        format!("<link name=\"l{i}\"/>{}", joint(&format!("j{i}"), "continuous", [&format!("l{}", i.max(1) - 1), &format!("l{i}")], ""))
    };
    let chain = format!(
        "<robot name=\"x\"><link name=\"l0\">{}</link>{}</robot>",
        inertial("", 1., [1.; 3]),
        (1..20_000).map(link).collect::<String>()
    );
    let error = Import { feet: vec!["l19999".into()], ..Import::default() }.urdf(&chain).unwrap_err().to_string();
    assert!(error.contains("19999 joints") && error.contains("at most"), "{error}");
    let long = " ".repeat(MAX_FILE + 1);
    assert!(import(&long).unwrap_err().to_string().contains("size of a URDF"));
}

#[test]
fn mutated_files_are_read_or_refused() {
    let parts = [
        "<", ">", "\"", "0", "-1", "1e308", "NaN", "inf", "-", " ", "", "link", "joint", "base", "LF_calf", "&lt;", "&#0;", "<!--",
        "\u{e9}",
    ];
    let [read, refused] = mutate(&quadruped(BALL), &parts, 2000, import);
    assert!(read > 20 && refused > 500, "{read} read, {refused} refused");
}

/// Replaces pieces of a text by random parts, and imports the result. Returns the numbers of texts that were read and refused.
pub fn mutate(good: &str, parts: &[&str], rounds: usize, import: impl Fn(&str) -> Result<Imported>) -> [usize; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let (mut read, mut refused) = (0, 0);
    for i in 0..rounds {
        let mut text: Vec<char> = good.chars().collect();
        for _ in 0..random.random_range(1..4) {
            let at = random.random_range(0..text.len());
            let until = (at + random.random_range(0..12)).min(text.len());
            let part = parts[random.random_range(0..parts.len())];
            text.splice(at..until, part.chars());
        }
        if i % 10 == 0 {
            text.truncate(random.random_range(0..text.len()));
        }
        match import(&text.into_iter().collect::<String>()) {
            Ok(imported) => {
                imported.robot.validate().unwrap();
                read += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                refused += 1;
            }
        }
    }
    [read, refused]
}

/// The humanoid of the tests: thighs and shins of 0.35 m, soles 0.06 m below the ankles with their centres 0.03 m ahead of them.
const HUMANOID: &str = include_str!("../../../tests/data/humanoid.urdf");

#[test]
fn a_humanoid_stands_on_level_soles_below_its_centre_of_mass() {
    let imported = Import::default().urdf(HUMANOID).unwrap();
    let robot = &imported.robot;
    let value = |name: &str| imported.configuration.iter().find(|(joint, _)| joint == name).unwrap().1;
    let (hip, knee, ankle) = (value("L_pitch"), value("L_knee"), value("L_ankle_pitch"));
    close(&[value("L_yaw"), value("L_roll"), value("L_ankle_roll"), hip + knee + ankle], &[0.; 4], 1e-6);
    close(&[value("R_pitch"), value("R_knee"), value("L_shoulder")], &[hip, knee, 0.], 1e-6);
    assert!(knee > 0.3, "{knee}");
    // A link at angle a about y hangs at (-sin a, -cos a).
    let (thigh, shin) = ([-hip.sin(), -hip.cos()], [-(hip + knee).sin(), -(hip + knee).cos()]);
    let leg = [0, 1].map(|i| 0.35 * (thigh[i] + shin[i]));
    // Trunk 20 kg at 0.2 m, arms 2 kg each at 0.2 m; of each leg 4 kg and 3 kg at the middle of thigh and shin, 1 kg at the ankle.
    let of_legs = [0, 1].map(|i| 2. * (4. * 0.175 * thigh[i] + 3. * (0.35 * thigh[i] + 0.175 * shin[i]) + leg[i]) / 40.);
    let center = [of_legs[0], 24. * 0.2 / 40. + of_legs[1]];
    close(&[robot.mass, imported.center_of_mass[0], imported.center_of_mass[2]], &[40., center[0], center[1]], 1e-9);
    // The centre of the sole is below the centre of mass.
    let sole = [leg[0] + 0.03 - center[0], leg[1] - 0.06 - center[1]];
    close(&robot.nominal_feet[0], &[0., 0.1, sole[1]], 1e-6);
    close(&robot.nominal_feet[1], &[sole[0], -0.1, -robot.base_height], 1e-9);
    let found = robot.sole.unwrap();
    close(&[found.length, found.width], &[0.2, 0.1], 1e-9);
    // The yaw of the hip ends at 0.26 rad; 0.05 rad are kept in hand. With straight legs the sole is 0.76 m below the hip.
    assert!(found.turn == 0.2 && robot.base_height > 0.85 * (0.76 + 0.12 - 0.13) && robot.foot_radius.is_none(), "{robot:?}");
    // Lever arms of a vertical force at the centre of the sole, about hip, knee and ankle.
    let levers = [(leg[0] + 0.03, 80.), (leg[0] - 0.35 * thigh[0] + 0.03, 120.), (0.03, 60.)];
    let force = levers.iter().map(|(lever, effort)| effort / lever.abs()).fold(40. / 1e-9, f64::min).min(3. * robot.weight());
    assert!((robot.force_limit.unwrap() - force).abs() < 1e-6 * force, "{force} and {:?}", robot.force_limit);
    assert!(imported.notes.iter().any(|note| note.contains("soles of 0.2 x 0.1 m")), "{:?}", imported.notes);
    assert_eq!(Robot::from_json(&serde_json::to_string(robot).unwrap()).unwrap(), *robot);
}

#[test]
fn level_soles_reach_their_box_with_any_allowed_yaw() {
    let robot = Import::default().urdf(HUMANOID).unwrap().robot;
    let (boxes, turn) = (robot.reach_boxes().collect::<Vec<_>>(), robot.sole.unwrap().turn);
    close(&[boxes[0].low[1], boxes[0].high[1]], &[-boxes[1].high[1], -boxes[1].low[1]], 1e-12);
    // Soles of 0.1 m, 0.02 m apart, with feet 0.2 m apart.
    assert!(boxes[0].low[1] >= -0.04 && boxes[0].low[2] < -0.025 && boxes[0].widths()[0] > 0.3 && boxes[0].widths()[2] > 0.1, "{boxes:?}");
    let mut random = ChaCha8Rng::seed_from_u64(35);
    for _ in 0..300 {
        for (foot, leg) in robot.joints.as_ref().unwrap().iter().enumerate() {
            // Points inside the slabs. Length and height are attained at half of the width.
            let reach = robot.reach.foot(foot);
            let offset = loop {
                let mut within = |axis: usize, share: f64| share * random.random_range(reach.sides[axis][0]..reach.sides[axis][1]);
                let offset = [(0, 1.), (1, 0.5), (2, 1.)].map(|(axis, share)| within(axis, share));
                if reach.slabs().all(|slab| (slab.sides[0]..slab.sides[1]).contains(&slab.along(offset))) {
                    break offset;
                }
            };
            let place = Vector3::from(robot.nominal_feet[foot]) + Vector3::from(offset);
            let level = nalgebra::UnitQuaternion::from_euler_angles(0., 0., random.random_range(-turn..turn));
            let (q, missed) = leg.approach_sole(&Isometry3::from_parts(place.into(), level), &leg.nominal());
            let at = leg.posture(&q);
            assert!(
                missed <= PRECISION && (at.tip - place).norm() <= PRECISION && at.attitude.angle_to(&level) < 1e-4,
                "{offset:?}: {missed}"
            );
            assert!(q.iter().zip(&leg.chain).all(|(v, joint)| (joint.limits[0]..=joint.limits[1]).contains(v)));
        }
    }
}

#[test]
fn soles_are_given_by_hand_or_refused() {
    let with = |text: &str, soles: &str| Import { soles: soles.parse().unwrap(), ..Import::default() }.urdf(text);
    let found = with(HUMANOID, "auto").unwrap().robot;
    let given = with(HUMANOID, "0.15, 0.08").unwrap().robot;
    let sole = given.sole.unwrap();
    assert_eq!((sole.length, sole.width, &given.nominal_feet), (0.15, 0.08, &found.nominal_feet));
    // A foot without shapes has its sole at the origin of its frame.
    let bare =
        HUMANOID.split("<collision>").map(|part| part.split_once("</collision>").map_or(part, |(_, after)| after)).collect::<String>();
    let placed = with(&bare, "0.2,0.1").unwrap().robot;
    assert_eq!((placed.sole.unwrap().width, with(&bare, "auto").unwrap().robot.sole), (0.1, None));
    assert!(placed.joints.unwrap()[0].tip == [0.; 3] && with(HUMANOID, "none").unwrap().robot.sole.is_none());
    for text in ["0.2", "wide,0.1", "0.2,0.1,0.3", ""] {
        assert!(text.parse::<Soles>().unwrap_err().to_string().contains("LENGTH,WIDTH"), "{text}");
    }
    // Legs of five joints, and straight legs.
    let five = HUMANOID.replace("ankle_roll\" type=\"revolute\"", "ankle_roll\" type=\"fixed\"");
    let (points, error) = (with(&five, "auto").unwrap(), with(&five, "0.2,0.1").unwrap_err().to_string());
    assert!(points.robot.sole.is_none() && points.notes.iter().any(|note| note.contains("5 joints")), "{:?}", points.notes);
    assert!(error.contains("the leg of `L_foot` has 5 joints") && error.contains("at least 6 joints"), "{error}");
    let straight = |soles| Import { configuration: configuration("L_knee=0").unwrap(), soles, ..Import::default() }.urdf(HUMANOID);
    assert!(straight(Soles::Size([0.2, 0.1])).unwrap_err().to_string().contains("bent knees"));
    assert!(with(HUMANOID, "9,0.1").unwrap_err().to_string().contains("robot.sole.length"));
    // A configuration with bent knees is kept.
    let bent = [("L_pitch", -0.5), ("L_knee", 1.), ("L_ankle_pitch", -0.5), ("R_pitch", -0.5), ("R_knee", 1.), ("R_ankle_pitch", -0.5)];
    let bent = bent.map(|(joint, value)| (joint.to_owned(), value)).to_vec();
    let kept = Import { configuration: bent.clone(), ..Import::default() }.urdf(HUMANOID).unwrap();
    assert!(kept.robot.sole.is_some() && bent.iter().all(|pair| kept.configuration.contains(pair)), "{:?}", kept.configuration);
}
