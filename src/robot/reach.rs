//! Reach of the feet: boxes about their nominal positions, with a short form for all feet and a long form for each foot.

use crate::error::{Error, Result, check_range};
use serde::de::value::SeqAccessDeserializer;
use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};
use serde::{Serialize, Serializer};
use std::fmt;

/// Shortest side of a box, m.
const SHORTEST_SIDE: f64 = 2e-3;
/// Largest distance of a side from the nominal position, m.
const FARTHEST_SIDE: f64 = 100.;

/// Reach boxes about the nominal positions of the feet, base axes, m.
///
/// JSON: `[x, y, z]`, half-widths for all feet, or for each foot `[[low, high], [low, high], [low, high]]`.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(untagged))]
pub enum Reach {
    /// Half-widths of the box of every foot.
    Symmetric([f64; 3]),
    /// Lower and upper side along x, y and z, `[feet][3][2]`.
    PerFoot(Vec<[[f64; 2]; 3]>),
}

/// Reach box of a foot about its nominal position, base axes, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachBox {
    /// Lower sides along x, y and z, zero or negative.
    pub low: [f64; 3],
    /// Upper sides along x, y and z, zero or positive.
    pub high: [f64; 3],
}

impl ReachBox {
    /// Centre, m.
    pub fn center(&self) -> [f64; 3] {
        std::array::from_fn(|axis| (self.low[axis] + self.high[axis]) / 2.)
    }

    /// Half of the width along each axis, m.
    pub fn half_widths(&self) -> [f64; 3] {
        self.widths().map(|width| width / 2.)
    }

    /// Width along each axis, m.
    pub fn widths(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.high[axis] - self.low[axis])
    }

    /// Horizontal distance of the farthest corner from the nominal position, m.
    pub fn farthest(&self) -> f64 {
        let [x, y] = [0, 1].map(|axis| self.high[axis].max(-self.low[axis]));
        x.hypot(y)
    }
}

impl Reach {
    /// Box of a foot. A foot without a box gets a box of zero size.
    pub fn of(&self, foot: usize) -> ReachBox {
        match self {
            Reach::Symmetric(half) => ReachBox { low: half.map(|v| -v), high: *half },
            Reach::PerFoot(feet) => {
                let sides = feet.get(foot).copied().unwrap_or_default();
                ReachBox { low: sides.map(|[low, _]| low), high: sides.map(|[_, high]| high) }
            }
        }
    }

    /// Boxes scaled by a factor about the nominal positions.
    pub fn scaled(&self, by: f64) -> Reach {
        match self {
            Reach::Symmetric(half) => Reach::Symmetric(half.map(|v| v * by)),
            Reach::PerFoot(feet) => Reach::PerFoot(feet.iter().map(|foot| foot.map(|sides| sides.map(|v| v * by))).collect()),
        }
    }

    /// Checks the boxes of a robot with `feet` feet.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first number that is out of range, or the number of boxes if it is wrong.
    pub(super) fn validate(&self, feet: usize) -> Result<()> {
        match self {
            Reach::Symmetric(half) => {
                let check = |(axis, &v): (usize, &f64)| check_range(&format!("robot.reach[{axis}]"), v, SHORTEST_SIDE / 2., FARTHEST_SIDE);
                half.iter().enumerate().try_for_each(check)
            }
            Reach::PerFoot(boxes) if boxes.len() != feet => {
                let limit = format!("{feet} boxes, one for each of `nominal_feet`, or 3 half-widths for all");
                Err(Error::invalid("robot.reach", format!("{} boxes", boxes.len()), limit))
            }
            Reach::PerFoot(boxes) => {
                for (foot, sides) in boxes.iter().enumerate() {
                    for (axis, &[low, high]) in sides.iter().enumerate() {
                        let place = format!("robot.reach[{foot}][{axis}]");
                        check_range(&format!("{place}[0]"), low, -FARTHEST_SIDE, 0.)?;
                        check_range(&format!("{place}[1]"), high, 0., FARTHEST_SIDE)?;
                        // Differences of decimal numbers are off in the last digit.
                        if high - low < SHORTEST_SIDE * (1. - 1e-9) {
                            return Err(Error::invalid(place, format!("[{low}, {high}]"), format!("at least {SHORTEST_SIDE} m wide")));
                        }
                    }
                }
                Ok(())
            }
        }
    }
}

impl From<[f64; 3]> for Reach {
    fn from(half: [f64; 3]) -> Reach {
        Reach::Symmetric(half)
    }
}

/// Formats as in JSON, with three digits.
impl fmt::Display for Reach {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Reach::Symmetric(half) => write!(f, "{half:.3?}"),
            Reach::PerFoot(feet) => write!(f, "{feet:.3?}"),
        }
    }
}

impl Serialize for Reach {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        match self {
            Reach::Symmetric(half) => half.serialize(serializer),
            Reach::PerFoot(feet) => feet.serialize(serializer),
        }
    }
}

/// One entry of the list: a half-width, or the box of a foot.
enum Entry {
    Half(f64),
    Sides([[f64; 2]; 3]),
}

/// Selects the form by the kind of the value, so that errors name the wrong number.
impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Kinds;
        impl<'de> Visitor<'de> for Kinds {
            type Value = Entry;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a half-width, or the three [low, high] of a foot")
            }

            fn visit_f64<E: de::Error>(self, v: f64) -> std::result::Result<Entry, E> {
                Ok(Entry::Half(v))
            }

            fn visit_i64<E: de::Error>(self, v: i64) -> std::result::Result<Entry, E> {
                Ok(Entry::Half(v as f64))
            }

            fn visit_u64<E: de::Error>(self, v: u64) -> std::result::Result<Entry, E> {
                Ok(Entry::Half(v as f64))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> std::result::Result<Entry, A::Error> {
                Deserialize::deserialize(SeqAccessDeserializer::new(seq)).map(Entry::Sides)
            }
        }
        deserializer.deserialize_any(Kinds)
    }
}

/// Selects the form by the kind of the first entry.
impl<'de> Deserialize<'de> for Reach {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Reach;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("3 half-widths, or for each foot three [low, high]")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> std::result::Result<Reach, A::Error> {
                let (mut half, mut boxes) = (Vec::new(), Vec::new());
                while let Some(entry) = seq.next_element()? {
                    match entry {
                        Entry::Half(v) => half.push(v),
                        Entry::Sides(sides) => boxes.push(sides),
                    }
                    if !half.is_empty() && !boxes.is_empty() {
                        return Err(de::Error::custom("half-widths and boxes of feet are mixed, but all must be of one kind"));
                    }
                }
                if !boxes.is_empty() {
                    return Ok(Reach::PerFoot(boxes));
                }
                let count = half.len();
                half.try_into().map(Reach::Symmetric).map_err(|_| de::Error::invalid_length(count, &self))
            }
        }
        deserializer.deserialize_seq(Entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    /// The biped with another reach.
    fn biped(reach: &str) -> Result<Robot> {
        let mut json = serde_json::to_value(Robot::named("biped").unwrap()).unwrap();
        json["name"] = "own".into();
        json["reach"] = serde_json::from_str(reach).unwrap();
        Robot::from_json(&json.to_string())
    }

    #[test]
    fn both_forms_survive_a_round_trip_unchanged() {
        for text in ["[0.25,0.15,0.1]", "[[[-0.1,0.2],[0.0,0.1],[-0.2,0.05]],[[-0.1,0.2],[-0.1,0.0],[-0.2,0.05]]]"] {
            let reach: Reach = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&reach).unwrap(), text);
            assert_eq!(biped(text).unwrap().reach, reach);
        }
        assert_eq!(biped("[1, 2, 1]").unwrap().reach, Reach::Symmetric([1., 2., 1.]));
    }

    #[test]
    fn a_box_reports_its_sides_centre_and_farthest_corner() {
        let same = Reach::from([0.3, 0.2, 0.1]);
        assert_eq!(same.of(7), ReachBox { low: [-0.3, -0.2, -0.1], high: [0.3, 0.2, 0.1] });
        assert_eq!((same.of(0).center(), same.of(0).half_widths()), ([0.; 3], [0.3, 0.2, 0.1]));
        let boxes = biped("[[[-0.5, 0.25], [0, 0.5], [0, 1]], [[-0.25, 0.25], [-0.5, 0], [-1, 0]]]").unwrap().reach;
        let left = boxes.of(0);
        assert_eq!((left.center(), left.half_widths(), left.widths()), ([-0.125, 0.25, 0.5], [0.375, 0.25, 0.5], [0.75, 0.5, 1.]));
        assert_eq!(left.farthest(), 0.5f64.hypot(0.5));
        assert_eq!(boxes.of(2).widths(), [0.; 3]);
        assert_eq!(boxes.scaled(2.).of(1), ReachBox { low: [-0.5, -1., -2.], high: [0.5, 0., 0.] });
    }

    #[test]
    fn errors_name_the_number_and_the_limit() {
        for (reach, parts) in [
            ("[0.1, 0, 0.1]", &["robot.reach[1]", "0.001"][..]),
            ("[0.1, 0.1]", &["reach", "invalid length 2", "3 half-widths"]),
            ("[]", &["reach", "invalid length 0"]),
            ("0.1", &["reach", "3 half-widths"]),
            ("[0.1, \"far\", 0.1]", &["reach[1]", "a half-width"]),
            ("[0.1, [[-1, 1], [-1, 1], [-1, 1]], 0.1]", &["reach", "mixed"]),
            ("[[[-1, 1], [-1, 1], [-1, 1]]]", &["robot.reach", "1 boxes", "2 boxes"]),
            ("[[[-1, 1], [-1, 1]], [[-1, 1], [-1, 1], [-1, 1]]]", &["reach[0]", "invalid length 2"]),
            ("[[[-1, 1], [-1, 1], [-1, 1]], [[-1, 1], [-1, null], [-1, 1]]]", &["reach[1][1][1]", "null"]),
            ("[[[-1, 1], [-1, 1], [0.1, 1]], [[-1, 1], [-1, 1], [-1, 1]]]", &["robot.reach[0][2][0]", "0.1", "-100 to 0"]),
            ("[[[-1, 1], [-1, 1], [-1, 1]], [[-1, -0.5], [-1, 1], [-1, 1]]]", &["robot.reach[1][0][1]", "-0.5", "0 to 100"]),
            ("[[[-1, 1], [-1, 1], [-1, 1]], [[-1, 1], [-0.001, 0], [-1, 1]]]", &["robot.reach[1][1]", "[-0.001, 0]", "0.002"]),
        ] {
            let error = biped(reach).unwrap_err().to_string();
            assert!(parts.iter().all(|part| error.contains(part)), "{reach}: {error}");
            assert!(!error.contains("untagged"), "{error}");
        }
        biped("[[[-0.001, 0.001], [0, 0.002], [-0.002, 0]], [[-1, 1], [-1, 1], [-1, 1]]]").unwrap();
    }
}
