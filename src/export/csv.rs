//! Motions as CSV: a header with units and one row per instant. Frames and signs: [`super`].

use super::Sampled;
use crate::report::samples::Sample;

/// Names of the columns, in order.
///
/// * `soles` - true if the feet have soles
pub(crate) fn header(names: &[String], soles: bool) -> Vec<String> {
    let axes = ["x", "y", "z"];
    let mut columns = vec!["time_s".to_owned()];
    let mut of = |quantity: &str, parts: &[&str], unit: &str| {
        columns.extend(parts.iter().map(|part| [quantity, part, unit].into_iter().filter(|p| !p.is_empty()).collect::<Vec<_>>().join("_")));
    };
    of("base_position", &axes, "m");
    of("base_quaternion", &["w", "x", "y", "z"], "");
    of("base", &["roll", "pitch", "yaw"], "rad");
    of("base_velocity", &axes, "m/s");
    of("base_angular_velocity", &axes, "rad/s");
    for name in names {
        of(&format!("{name}_position"), &axes, "m");
        of(&format!("{name}_velocity"), &axes, "m/s");
        of(&format!("{name}_force"), &axes, "N");
        of(name, &["contact"], "");
        if soles {
            of(&format!("{name}_moment"), &axes, "Nm");
            of(name, &["yaw"], "rad");
        }
    }
    columns
}

/// Values of a row, in the order of [`header`].
pub(crate) fn row(sample: &Sample) -> Vec<f64> {
    let base = &sample.base;
    let mut values = vec![sample.time];
    values.extend(base.position.iter().chain(&base.quaternion).chain(&base.angles).chain(&base.velocity).chain(&base.angular_velocity));
    for foot in &sample.feet {
        values.extend(foot.position.iter().chain(&foot.velocity).chain(&foot.force));
        values.push(f64::from(u8::from(foot.stance)));
        if let Some(sole) = &foot.sole {
            values.extend(sole.moment);
            values.push(sole.yaw());
        }
    }
    values
}

/// Text of the file. Numbers have enough digits to be read back exactly.
pub fn csv(sampled: &Sampled) -> String {
    // Names consist of letters, digits and underscores, so that nothing needs quotes.
    let soles = sampled.samples.iter().flat_map(|sample| &sample.feet).any(|foot| foot.sole.is_some());
    let mut text = header(&sampled.names, soles).join(",") + "\n";
    for sample in &sampled.samples {
        let whole = |v: &f64| if v.fract() == 0. && v.abs() < 1e15 { format!("{}", *v + 0.) } else { format!("{v:?}") };
        text += &row(sample).iter().map(whole).collect::<Vec<_>>().join(",");
        text += "\n";
    }
    text
}
