//! JSON Schemas of the input and output files, derived from their types.

use super::result::SolveResult;
use crate::gait::Trajectory;
use crate::robot::Robot;
use crate::terrain::Terrain;
use schemars::generate::SchemaSettings;
use serde_json::Value;

/// A file format with a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Document {
    /// `result.json` of `solve`.
    Result,
    /// `trajectory.json`.
    Trajectory,
    /// Robot file.
    Robot,
    /// Terrain file.
    Terrain,
}

/// JSON Schema (draft 2020-12) of a file format. In input files, fields with a default are optional. Ranges of numbers are checked by the
/// program, not by the schema.
pub fn schema(document: Document) -> Value {
    let settings = match document {
        Document::Result => SchemaSettings::draft2020_12().for_serialize(),
        _ => SchemaSettings::draft2020_12().for_deserialize(),
    };
    let generator = settings.into_generator();
    let schema = match document {
        Document::Result => generator.into_root_schema_for::<SolveResult>(),
        Document::Trajectory => generator.into_root_schema_for::<Trajectory>(),
        Document::Robot => generator.into_root_schema_for::<Robot>(),
        Document::Terrain => generator.into_root_schema_for::<Terrain>(),
    };
    schema.to_value()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::curves::Extreme;

    #[test]
    fn values_that_may_be_infinite_may_be_null() {
        // JSON has no infinity.
        let text = serde_json::to_string(&Extreme { value: f64::INFINITY, time: 0., foot: None }).unwrap();
        assert!(text.starts_with(r#"{"value":null"#));
        let schema = schema(Document::Result);
        for place in [
            "Extreme/properties/value",
            "Worst/properties/violation",
            "FamilyReport/properties/max_violation",
            "GaitResult/properties/objective",
        ] {
            let types = &schema["$defs"].pointer(&format!("/{place}/type")).unwrap_or_else(|| panic!("{place}"));
            assert_eq!(**types, serde_json::json!(["number", "null"]), "{place}");
        }
    }

    #[test]
    fn fields_are_described_by_their_documentation() {
        for (document, place, words) in [
            (Document::Robot, "/properties/mass/description", "Mass, kg."),
            (Document::Terrain, "/properties/friction/description", "Friction coefficient"),
            (Document::Trajectory, "/properties/base_lin/description", "world frame"),
            (Document::Result, "/properties/first_feasible_seconds/description", "first certified gait"),
        ] {
            let schema = schema(document);
            let text = schema.pointer(place).and_then(Value::as_str).unwrap_or_default();
            assert!(text.contains(words), "{document:?} {place}: {text}");
        }
    }
}
