//! Values and errors between Python and Rust.

use super::Error as PyError;
use crate::error::{Error, Result, from_json, from_value};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Exception of an error, with the same text; an `OSError` if the operating system refused.
pub fn raised(error: impl Into<Error>) -> PyErr {
    let error = error.into();
    let sentence = error.to_string();
    let mut inner = &error;
    while let Error::InFile { source, .. } = inner {
        inner = source;
    }
    match inner {
        Error::Io { source, .. } => match source.raw_os_error() {
            // From two arguments, Python makes the class of the number, e.g. FileNotFoundError.
            Some(number) => PyOSError::new_err((number, sentence)),
            None => PyOSError::new_err(sentence),
        },
        _ => PyError::new_err(sentence),
    }
}

/// Python value (dictionaries, lists, numbers, texts) of a value, as files have it.
pub fn to_python<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(raised)?;
    py.import("json")?.call_method1("loads", (text,))
}

/// Value that dictionaries, lists and arrays describe.
///
/// * `place` - name of the value, for errors
pub fn from_python<T: DeserializeOwned>(value: &Bound<'_, PyAny>, place: &str) -> PyResult<T> {
    let py = value.py();
    let kind = value.get_type().name()?;
    let options = pyo3::types::PyDict::new(py);
    options.set_item("allow_nan", false)?;
    // Arrays and scalars of numpy become lists and numbers.
    options.set_item("default", py.import("operator")?.call_method1("methodcaller", ("tolist",))?)?;
    let text = py.import("json")?.call_method("dumps", (value,), Some(&options)).map_err(|e| {
        raised(Error::invalid(place, format!("{kind} ({})", e.value(py)), "finite numbers, texts, lists and dictionaries of them"))
    })?;
    let text: String = text.extract()?;
    from_json(&text).and_then(from_value).map_err(|e| raised(e.within(place)))
}

/// Place (x, y), and its height if there is a third number, m.
pub fn place(value: &Bound<'_, PyAny>, name: &str) -> PyResult<([f64; 2], Option<f64>)> {
    let limit = "2 or 3 numbers: x, y, z in m";
    let numbers: Vec<f64> = value.extract().map_err(|_| {
        let shown = value.repr().map_or_else(|_| "not numbers".into(), |text| text.to_string());
        raised(Error::invalid(name, shown, limit))
    })?;
    match *numbers {
        [x, y] => Ok(([x, y], None)),
        [x, y, z] => Ok(([x, y], Some(z))),
        _ => Err(raised(Error::invalid(name, format!("{} numbers", numbers.len()), limit))),
    }
}

/// Conversion of errors of this crate to exceptions.
pub trait Raise<T> {
    /// Value, or the exception of its error.
    fn raise(self) -> PyResult<T>;
}

impl<T> Raise<T> for Result<T> {
    fn raise(self) -> PyResult<T> {
        self.map_err(raised)
    }
}
