//! Reach of the feet: boxes about their nominal positions, with a short form for all feet and a long form for each foot. Slabs may cut the
//! corners of a box, which a leg that bends one way does not reach.

use crate::error::{Error, Result, check_range};
use nalgebra::Vector3;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};
use std::borrow::Cow;
use std::fmt;

/// Shortest side of a box, m.
const SHORTEST_SIDE: f64 = 2e-3;
/// Largest distance of a side from the nominal position, m.
const FARTHEST_SIDE: f64 = 100.;
/// Largest number of slabs that cut the box of a foot.
const MAX_DIAGONALS: usize = 6;
/// Largest difference between the length of a normal and 1.
const UNIT: f64 = 1e-6;

/// Reach of the feet about their nominal positions, base axes, m.
///
/// JSON: `[x, y, z]`, half-widths for all feet, or for each foot `[[low, high], [low, high], [low, high]]` or a [`FootReach`].
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(untagged))]
pub enum Reach {
    /// Half-widths of the box of every foot.
    Symmetric([f64; 3]),
    /// Reach of each foot.
    PerFoot(#[cfg_attr(feature = "schema", schemars(with = "Vec<FootForms>"))] Vec<FootReach>),
}

/// Reach of a foot about its nominal position, base axes, m: the offsets inside a box and inside slabs that cut its corners.
///
/// JSON: `[[low, high], [low, high], [low, high]]`, or `{"sides": ..., "diagonals": [{"normal": [x, y, z], "sides": [low, high]}]}`.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FootReach {
    /// Lower and upper side of the box along x, y and z.
    pub sides: [[f64; 2]; 3],
    /// Slabs that cut the box.
    pub diagonals: Vec<Slab>,
}

/// Offsets `v` of a foot from its nominal position between two parallel faces: `low <= normal . v <= high`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Slab {
    /// Unit normal of both faces, base axes.
    pub normal: [f64; 3],
    /// Lower and upper face, m: zero or negative, and zero or positive.
    pub sides: [f64; 2],
}

/// Forms of a [`FootReach`] in files.
#[cfg(feature = "schema")]
#[derive(schemars::JsonSchema)]
#[schemars(untagged)]
#[allow(dead_code, reason = "only its schema is used")]
enum FootForms {
    /// Lower and upper side of the box along x, y and z, m.
    Box([[f64; 2]; 3]),
    /// Box whose corners are cut.
    Cut(FootReach),
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

impl Slab {
    /// Coordinate of an offset along the normal, m.
    pub fn along(&self, v: [f64; 3]) -> f64 {
        let [x, y, z] = self.normal;
        x * v[0] + y * v[1] + z * v[2]
    }

    /// Slab with other sides.
    pub fn with_sides(self, sides: [f64; 2]) -> Slab {
        Slab { sides, ..self }
    }

    /// Slab with sides that are scaled by the factors along x, y and z, weighted by the squares of its normal.
    pub fn stretched(self, factors: [f64; 3]) -> Slab {
        self.scaled(self.normal.iter().zip(factors).map(|(n, factor)| n * n * factor).sum())
    }

    fn scaled(self, by: f64) -> Slab {
        self.with_sides(self.sides.map(|v| v * by))
    }

    /// Checks that the nominal position is inside, and that the slab is wide enough.
    fn validate(&self, place: &str) -> Result<()> {
        let [low, high] = self.sides;
        check_range(&format!("{place}[0]"), low, -FARTHEST_SIDE, 0.)?;
        check_range(&format!("{place}[1]"), high, 0., FARTHEST_SIDE)?;
        // Differences of decimal numbers are off in the last digit.
        if high - low < SHORTEST_SIDE * (1. - 1e-9) {
            return Err(Error::invalid(place, format!("[{low}, {high}]"), format!("at least {SHORTEST_SIDE} m wide")));
        }
        Ok(())
    }
}

impl FootReach {
    /// Number of slabs.
    pub fn count(&self) -> usize {
        3 + self.diagonals.len()
    }

    /// A slab: those of the box along x, y and z come before the diagonals.
    pub fn slab(&self, number: usize) -> Slab {
        let of_box = |sides| Slab { normal: std::array::from_fn(|i| if i == number { 1. } else { 0. }), sides };
        self.sides.get(number).map_or_else(|| self.diagonals[number - 3], |sides| of_box(*sides))
    }

    /// All slabs.
    pub fn slabs(&self) -> impl Iterator<Item = Slab> {
        (0..self.count()).map(|number| self.slab(number))
    }

    /// Edges: pairs of corners, m.
    pub fn edges(&self) -> Vec<[[f64; 3]; 2]> {
        let sides = |slab: Slab| {
            let (normal, [low, high]) = (Vector3::from(slab.normal), slab.sides);
            [(normal, high), (-normal, -low)]
        };
        // Outward normals and distances.
        let faces: Vec<(Vector3<f64>, f64)> = self.slabs().flat_map(sides).collect();
        let mut edges = Vec::new();
        for (i, (a, distance_a)) in faces.iter().enumerate() {
            for (b, distance_b) in &faces[..i] {
                let line = a.cross(b);
                if line.norm() < 1e-9 {
                    continue;
                }
                let point = (b.cross(&line) * *distance_a + line.cross(a) * *distance_b) / line.norm_squared();
                let inside = |[from, to]: [f64; 2], (normal, distance): &(Vector3<f64>, f64)| {
                    let (along, room) = (normal.dot(&line), distance - normal.dot(&point));
                    match along.abs() > 1e-9 {
                        true if along > 0. => [from, to.min(room / along)],
                        true => [from.max(room / along), to],
                        false if room < -1e-9 => [from, f64::NEG_INFINITY],
                        false => [from, to],
                    }
                };
                let [from, to] = faces.iter().fold([f64::NEG_INFINITY, f64::INFINITY], inside);
                if to > from + 1e-9 {
                    edges.push([from, to].map(|at| (point + line * at).into()));
                }
            }
        }
        edges
    }

    /// Reach with the same normals and other sides of its slabs.
    ///
    /// * `sides` - new sides of a slab, which is one of [`FootReach::slabs`]
    pub fn with_sides(&self, mut sides: impl FnMut(Slab) -> [f64; 2]) -> FootReach {
        let all: Vec<Slab> = self.slabs().map(|slab| slab.with_sides(sides(slab))).collect();
        FootReach { sides: std::array::from_fn(|axis| all[axis].sides), diagonals: all[3..].to_vec() }
    }

    fn validate(&self, place: &str) -> Result<()> {
        for (number, slab) in self.slabs().enumerate().take(3) {
            slab.validate(&format!("{place}[{number}]"))?;
        }
        let count = self.diagonals.len();
        if count > MAX_DIAGONALS {
            return Err(Error::invalid(format!("{place}.diagonals"), format!("{count} slabs"), format!("at most {MAX_DIAGONALS}")));
        }
        for (number, slab) in self.diagonals.iter().enumerate() {
            let place = format!("{place}.diagonals[{number}]");
            let length = slab.along(slab.normal).sqrt();
            check_range(&format!("length of {place}.normal"), length, 1. - UNIT, 1. + UNIT)?;
            slab.validate(&format!("{place}.sides"))?;
        }
        Ok(())
    }
}

impl From<[[f64; 2]; 3]> for FootReach {
    fn from(sides: [[f64; 2]; 3]) -> FootReach {
        FootReach { sides, diagonals: Vec::new() }
    }
}

impl Reach {
    /// Box for each foot: lower and upper side along x, y and z, `[feet][3][2]`, m.
    pub fn boxes(feet: impl IntoIterator<Item = [[f64; 2]; 3]>) -> Reach {
        Reach::PerFoot(feet.into_iter().map(FootReach::from).collect())
    }

    /// Reach of a foot. A foot without one gets a box of zero size.
    pub fn foot(&self, foot: usize) -> Cow<'_, FootReach> {
        match self {
            Reach::Symmetric(half) => Cow::Owned(half.map(|v| [-v, v]).into()),
            Reach::PerFoot(feet) => feet.get(foot).map_or_else(|| Cow::Owned([[0.; 2]; 3].into()), Cow::Borrowed),
        }
    }

    /// Box of a foot.
    pub fn of(&self, foot: usize) -> ReachBox {
        let sides = self.foot(foot).sides;
        ReachBox { low: sides.map(|[low, _]| low), high: sides.map(|[_, high]| high) }
    }

    /// Width of a foot's reach along an axis through its nominal position, m.
    pub fn width(&self, foot: usize, axis: usize) -> f64 {
        let inside = |[low, high]: [f64; 2], slab: Slab| {
            let share = slab.normal[axis];
            let ends = slab.sides.map(|side| side / share);
            match share {
                0. => [low, high],
                _ => [low.max(ends[0].min(ends[1])), high.min(ends[0].max(ends[1]))],
            }
        };
        let [low, high] = self.foot(foot).slabs().fold([f64::NEG_INFINITY, f64::INFINITY], inside);
        high - low
    }

    /// Reach scaled by a factor about the nominal positions.
    pub fn scaled(&self, by: f64) -> Reach {
        match self {
            Reach::Symmetric(half) => Reach::Symmetric(half.map(|v| v * by)),
            Reach::PerFoot(feet) => Reach::PerFoot(feet.iter().map(|foot| foot.with_sides(|slab| slab.scaled(by).sides)).collect()),
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
            Reach::PerFoot(all) => all.iter().enumerate().try_for_each(|(foot, reach)| reach.validate(&format!("robot.reach[{foot}]"))),
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
            Reach::PerFoot(feet) => {
                let feet: Vec<String> = feet.iter().map(FootReach::to_string).collect();
                write!(f, "[{}]", feet.join(", "))
            }
        }
    }
}

/// Formats as in JSON, with three digits.
impl fmt::Display for FootReach {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let FootReach { sides, diagonals } = self;
        if diagonals.is_empty() {
            return write!(f, "{sides:.3?}");
        }
        let slab = |Slab { normal, sides }: &Slab| format!("{{\"normal\": {normal:.3?}, \"sides\": {sides:.3?}}}");
        let diagonals: Vec<String> = diagonals.iter().map(slab).collect();
        write!(f, "{{\"sides\": {sides:.3?}, \"diagonals\": [{}]}}", diagonals.join(", "))
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

/// A reach without diagonals is written as its box.
impl Serialize for FootReach {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        if self.diagonals.is_empty() {
            return self.sides.serialize(serializer);
        }
        let mut fields = serializer.serialize_struct("FootReach", 2)?;
        fields.serialize_field("sides", &self.sides)?;
        fields.serialize_field("diagonals", &self.diagonals)?;
        fields.end()
    }
}

/// One entry of the list: a half-width, or the reach of a foot.
enum Entry {
    Half(f64),
    Foot(FootReach),
}

/// Selects the form by the kind of the value, so that errors name the wrong number.
impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Kinds;
        impl<'de> Visitor<'de> for Kinds {
            type Value = Entry;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a half-width, or the three [low, high] of a foot, or its sides and diagonals")
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
                <[[f64; 2]; 3]>::deserialize(SeqAccessDeserializer::new(seq)).map(|sides| Entry::Foot(sides.into()))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> std::result::Result<Entry, A::Error> {
                FootReach::deserialize(MapAccessDeserializer::new(map)).map(Entry::Foot)
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
                let (mut half, mut feet) = (Vec::new(), Vec::new());
                while let Some(entry) = seq.next_element()? {
                    match entry {
                        Entry::Half(v) => half.push(v),
                        Entry::Foot(foot) => feet.push(foot),
                    }
                    if !half.is_empty() && !feet.is_empty() {
                        return Err(de::Error::custom("half-widths and boxes of feet are mixed, but all must be of one kind"));
                    }
                }
                if !feet.is_empty() {
                    return Ok(Reach::PerFoot(feet));
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
    fn all_forms_survive_a_round_trip_unchanged() {
        let cut = "{\"sides\":[[-0.1,0.2],[-0.1,0.0],[-0.2,0.05]],\"diagonals\":[{\"normal\":[0.6,0.0,-0.8],\"sides\":[-0.1,0.0]}]}";
        for text in [
            "[0.25,0.15,0.1]",
            "[[[-0.1,0.2],[0.0,0.1],[-0.2,0.05]],[[-0.1,0.2],[-0.1,0.0],[-0.2,0.05]]]",
            &format!("[[[-0.1,0.2],[0.0,0.1],[-0.2,0.05]],{cut}]"),
            &format!("[{cut},{cut}]"),
        ] {
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
    fn diagonals_cut_the_width_through_the_nominal_position() {
        let slab = |normal, sides| Slab { normal, sides };
        let cut = vec![slab([0.6, 0., -0.8], [-0.3, 0.06]), slab([-0.6, 0., 0.8], [-0.5, 0.12]), slab([0., -1., 0.], [0., 0.1])];
        let reach = Reach::PerFoot(vec![FootReach { sides: [[-0.3, 0.4], [-0.2, 0.5], [-0.1, 0.1]], diagonals: cut }]);
        // x from -0.12 / 0.6 to 0.06 / 0.6, y from -0.1 to 0.
        let widths = [0, 1, 2].map(|axis| reach.width(0, axis));
        assert!(widths.iter().zip([0.3, 0.1, 0.175]).all(|(a, b)| (a - b).abs() < 1e-12), "{widths:?}");
        assert_eq!(reach.of(0).widths(), [0.7, 0.7, 0.2]);
        let foot = reach.foot(0);
        assert!((foot.diagonals[0].along([0.1, 7., 0.2]) + 0.1).abs() < 1e-15);
        let normals: Vec<[f64; 3]> = foot.slabs().take(3).map(|slab| slab.normal).collect();
        assert_eq!(normals, [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
        let doubled = foot.with_sides(|slab| slab.sides.map(|v| 2. * v));
        assert_eq!(reach.scaled(2.).foot(0).into_owned(), doubled);
        assert_eq!((doubled.sides[1], doubled.diagonals[1].sides), ([-0.4, 1.], [-1., 0.24]));
        let text = reach.to_string();
        assert!(
            text.starts_with("[{\"sides\": [[-0.300, 0.400], ") && text.contains("{\"normal\": [0.600, 0.000, -0.800], \"sides\": [-0.300")
        );
        assert!(serde_json::from_str::<Reach>(&text).is_ok(), "{text}");
    }

    #[test]
    fn a_cut_box_has_the_edges_of_a_prism() {
        let mut foot = FootReach::from([[-1., 1.], [-2., 2.], [-3., 3.]]);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        let length = |edge: &[[f64; 3]; 2]| (Vector3::from(edge[0]) - Vector3::from(edge[1])).norm();
        let lengths = |foot: &FootReach| foot.edges().iter().map(length).sum::<f64>();
        assert!(foot.edges().len() == 12 && close(lengths(&foot), 4. * 12.), "{:?}", foot.edges());
        // Of the corner at x = 1 and z = 3 a triangle is cut, with sides of 1 along x and 0.75 along z.
        foot.diagonals.push(Slab { normal: [0.6, 0., 0.8], sides: [-9., 0.6 + 2.4 - 0.6] });
        assert!(foot.edges().len() == 15 && close(lengths(&foot), 48. + 4. + 2. * (1.25 - 1. - 0.75)), "{:?}", foot.edges());
        assert!(foot.edges().as_flattened().iter().all(|corner| foot.slabs().all(|slab| slab.along(*corner) < slab.sides[1] + 1e-9)));
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
        let cut = |diagonals: &str| {
            let foot = format!("{{\"sides\": [[-1, 1], [-1, 1], [-1, 1]], \"diagonals\": [{diagonals}]}}");
            biped(&format!("[[[-1, 1], [-1, 1], [-1, 1]], {foot}]")).map_err(|error| error.to_string())
        };
        cut(r#"{"normal": [0.6, 0, 0.8], "sides": [-0.1, 0]}"#).unwrap();
        for (diagonals, parts) in [
            (r#"{"normal": [0.6, 0, 0.9], "sides": [-0.1, 0.1]}"#, &["robot.reach[1].diagonals[0].normal", "1.08"][..]),
            (r#"{"normal": [0.6, 0, 0.8], "sides": [0.1, 0.2]}"#, &["robot.reach[1].diagonals[0].sides[0]", "-100 to 0"]),
            (r#"{"normal": [0.6, 0, 0.8], "sides": [0, 0.001]}"#, &["robot.reach[1].diagonals[0].sides", "0.002"]),
            (r#"{"normal": [0.6, 0, 0.8]}"#, &["reach[1].diagonals[0]", "sides"]),
            (r#"{"normal": [0.6, 0, 0.8], "sides": [-1, 1], "low": 0}"#, &["reach[1].diagonals[0]", "low"]),
            (&[r#"{"normal": [0.6, 0, 0.8], "sides": [-1, 1]}"#; 7].join(","), &["robot.reach[1].diagonals", "7 slabs", "at most 6"]),
        ] {
            let error = cut(diagonals).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{diagonals}: {error}");
        }
        biped("[[[-0.001, 0.001], [0, 0.002], [-0.002, 0]], [[-1, 1], [-1, 1], [-1, 1]]]").unwrap();
    }
}
