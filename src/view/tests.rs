use super::*;
use crate::gait::{Curve, FootCurves};
use crate::verify::verify;
use serde_json::Value;

/// Motion of a monoped in stance whose base rises by 5 cm.
fn trajectory() -> Trajectory {
    let curve = |nodes: [[f64; 6]; 2]| Curve { poly_durations: vec![0.5], nodes: nodes.to_vec() };
    let base = curve([[0., 0., 0.58, 0., 0., 0.], [0., 0., 0.63, 0., 0., 0.]]);
    let feet = vec![FootCurves::new(curve([[0.; 6]; 2]), curve([[0., 0., 196., 0., 0., 0.]; 2]))];
    Trajectory::new(vec![vec![0.5]], 0.5, [base, curve([[0.; 6]; 2])], feet)
}

fn page_of(names: &[&str], robot: &Robot, terrain: &Terrain, trajectory: &Trajectory) -> Result<String> {
    let (force_limit, terms, about) = (600., ["a term".into()], ["hop".into()]);
    let report = verify(trajectory, robot, terrain, force_limit).unwrap();
    let scene = |&name: &_| Scene { name, trajectory, robot, terrain, force_limit, terms: &terms, report: &report, about: &about };
    page(&names.iter().map(scene).collect::<Vec<_>>())
}

/// Data of a page as a browser reads it, up to the first end of a script.
fn data_of(page: &str) -> Value {
    let start = r#"<script type="application/json" id="data">"#;
    let (_, rest) = page.split_once(start).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_page_holds_the_curves_of_its_trajectory() {
    let (robot, trajectory) = (Robot::named("monoped").unwrap(), trajectory());
    let page = page_of(&["rise"], &robot, &Terrain::flat(), &trajectory).unwrap();
    let data = data_of(&page);
    let result = &data["results"][0];
    assert_eq!(result["times"], 51);
    let numbers = |value: &Value| value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<f64>>();
    let heights: Vec<f64> = numbers(&result["position"]).into_iter().skip(2).step_by(3).collect();
    // A cubic from rest to rest covers the share 3 u^2 - 2 u^3 of the distance at u.
    for (k, height) in heights.iter().enumerate() {
        let u = k as f64 / 50.;
        assert!((height - (0.58 + 0.05 * (3. * u * u - 2. * u * u * u))).abs() < 6e-6, "sample {k}: {height}");
    }
    let foot = &result["feet"][0];
    assert_eq!(numbers(&foot["normal_force"]), [196.; 51]);
    assert_eq!(numbers(&foot["friction_use"]), [0.; 51]);
    assert_eq!(foot["stances"], serde_json::json!([[0.0, 0.5]]));
    assert_eq!(foot["footholds"], serde_json::json!([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]));
    // The certificate is that of the motion, in which the base rises although the force is less than the weight.
    assert_eq!(result["certificate"]["feasible"], false);
    assert!(result["certificate"]["verdict"].as_str().unwrap().starts_with("not certified: "));
    let push = &result["certificate"]["worst"][0];
    assert_eq!((push["value"].as_f64(), push["limit"].as_f64()), (Some(196.), Some(600.0001)));
    assert_eq!(result["certificate"]["terms"][0], "a term");
}

#[cfg(feature = "urdf")]
#[test]
fn legs_of_an_imported_robot_are_rods_from_joint_to_joint_and_end_at_the_foot() {
    use crate::gait::joints::tests::{motion, quadruped};
    use nalgebra::{Rotation3, Vector3};
    let robot = quadruped();
    let trajectory = motion(&robot);
    let data = data_of(&page_of(&["walk"], &robot, &Terrain::flat(), &trajectory).unwrap());
    let result = &data["results"][0];
    let vectors = |value: &Value| -> Vec<Vector3<f64>> {
        let numbers: Vec<f64> = value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        numbers.chunks_exact(3).map(Vector3::from_column_slice).collect()
    };
    let (base, angles) = (vectors(&result["position"]), vectors(&result["angles"]));
    for (foot, leg) in result["feet"].as_array().unwrap().iter().zip(robot.joints.as_ref().unwrap()) {
        let (links, places) = (vectors(&foot["links"]), vectors(&foot["position"]));
        assert_eq!((foot["joints"].as_u64(), links.len(), foot["radius"].as_f64()), (Some(3), 3 * 51, Some(leg.radius)));
        let near = |value: f64, expected: f64| assert!((value - expected).abs() < 1e-4, "{value} m instead of {expected} m");
        for (k, chain) in links.chunks_exact(3).enumerate() {
            near((chain[0] - leg.chain[0].origin.translation.vector).norm(), 0.);
            for j in 1..3 {
                near((chain[j] - chain[j - 1]).norm(), leg.chain[j].origin.translation.vector.norm());
            }
            let turn = Rotation3::from_euler_angles(angles[k].x, angles[k].y, angles[k].z);
            let center = places[k] + Vector3::z() * leg.radius;
            near((base[k] + turn * chain[2] - center).norm(), Vector3::from(leg.tip).norm());
        }
    }
    let named = data_of(&page_of(&["rise"], &Robot::named("monoped").unwrap(), &Terrain::flat(), &self::trajectory()).unwrap());
    assert_eq!((&named["results"][0]["feet"][0]["joints"], &named["results"][0]["feet"][0]["links"]), (&0.into(), &Value::Array(vec![])));
}

#[test]
fn names_in_the_data_cannot_inject_html() {
    let evil = "</script><script>alert(1)</script><!--";
    let robot = Robot { name: "a</SCRIPT >&\"'".into(), ..Robot::named("monoped").unwrap() };
    let terrain = Terrain { name: "/*page.js*/ <b>".into(), ..Terrain::flat() };
    let page = page_of(&[evil], &robot, &terrain, &trajectory()).unwrap();
    let data = data_of(&page);
    assert_eq!(data["results"][0]["name"], evil);
    assert_eq!(data["results"][0]["robot"], robot.name);
    assert_eq!(data["results"][0]["terrain"], terrain.name);
    // Only the page's own scripts.
    assert_eq!(page.to_lowercase().matches("</script").count(), 5);
    assert!(!page.contains("<script>alert") && !page.contains("<b>") && !page.contains("<!--"));
}

#[test]
fn a_page_is_complete_and_loads_nothing() {
    let robot = Robot::named("monoped").unwrap();
    let page = page_of(&["rise"], &robot, &Terrain::flat(), &trajectory()).unwrap();
    for part in [
        include_str!("page.css"),
        include_str!("three.min.js"),
        include_str!("scene.js"),
        include_str!("plots.js"),
        include_str!("page.js"),
    ] {
        assert!(page.contains(part));
        assert!(!part.to_lowercase().contains("</script") && !part.contains("<!--"));
    }
    assert!(page.ends_with("</html>\n"));
    assert!(page.contains("default-src 'none'"));
    for loading in [" src=", "<link", "@import", "url("] {
        assert!(!page.replace(include_str!("three.min.js"), "").contains(loading), "{loading}");
    }
}

#[test]
fn a_page_shows_up_to_eight_results() {
    let robot = Robot::named("monoped").unwrap();
    let page = |names: &[&str]| page_of(names, &robot, &Terrain::flat(), &trajectory());
    let data = data_of(&page(&["a", "b"]).unwrap());
    assert_eq!((data["results"][0]["name"].as_str(), data["results"][1]["name"].as_str()), (Some("a"), Some("b")));
    assert!(page(&["x"; 9]).unwrap_err().to_string().contains("results: 9, but it must be 1 to 8"));
    assert!(page(&[]).is_err());
}
