//! Errors: invalid input and failures of the environment. The outcome of a solve is not an error, see [`crate::solver::Status`].

use std::path::{Path, PathBuf};

/// Error outside the numerical methods.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value breaks a limit.
    #[error("{place}: {value}, but it must be {limit}")]
    Invalid {
        /// Place of the value, for example `foot 2, phase 3, duration`.
        place: String,
        /// Value found.
        value: String,
        /// Accepted values.
        limit: String,
    },
    /// A name is not in a list.
    #[error("unknown {what} `{}`{}; known: {known}", name.escape_debug(), meant(name, known))]
    Unknown {
        /// Kind of thing that was named.
        what: &'static str,
        /// Name given.
        name: String,
        /// Accepted names, separated by commas.
        known: String,
    },
    /// Text does not have the expected format.
    #[error("{message}")]
    Format {
        /// Message of the parser, with line and column if it knows them.
        message: String,
    },
    /// Error inside a file.
    #[error("{}{}: {source}", path.display(), line.map(|l| format!(", line {l}")).unwrap_or_default())]
    InFile {
        /// Path of the file.
        path: PathBuf,
        /// Line, counted from 1, for formats with one object per line.
        line: Option<usize>,
        /// Error at that place.
        source: Box<Error>,
    },
    /// The requested GPU does not exist or cannot be used.
    #[error("{message}")]
    Device {
        /// Requested device, and what was found instead.
        message: String,
    },
    /// The request needs a part that this build does not have.
    #[error("{message}")]
    Missing {
        /// Name of the part, and how to get it.
        message: String,
    },
    /// A search ended before it had a result.
    #[error("{message}")]
    Ended {
        /// Reason.
        message: String,
    },
    /// The operating system refused an operation.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// Operation, for example `read`.
        action: &'static str,
        /// Path of the file.
        path: PathBuf,
        /// Answer of the operating system.
        source: std::io::Error,
    },
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Error for a value that breaks a limit.
    pub fn invalid(place: impl Into<String>, value: impl std::fmt::Display, limit: impl Into<String>) -> Self {
        Error::Invalid { place: place.into(), value: value.to_string(), limit: limit.into() }
    }

    /// Adds the file and the line in it.
    pub fn in_file(self, path: &Path, line: Option<usize>) -> Self {
        Error::InFile { path: path.to_owned(), line, source: Box::new(self) }
    }

    /// Adds the enclosing place to the error.
    pub fn within(self, outer: impl std::fmt::Display) -> Self {
        match self {
            Error::Invalid { place, value, limit } => Error::Invalid { place: format!("{outer}: {place}"), value, limit },
            Error::Format { message } => Error::Format { message: format!("{outer}: {message}") },
            unknown @ Error::Unknown { .. } => Error::Format { message: format!("{outer}: {unknown}") },
            other => other,
        }
    }
}

impl From<serde_json::Error> for Error {
    fn from(e: serde_json::Error) -> Self {
        Error::Format { message: e.to_string() }
    }
}

/// Suggestion `; did you mean ...?` if a known name is similar.
fn meant(name: &str, known: &str) -> String {
    let near = |other: &&str| strsim::damerau_levenshtein(name, other) <= (name.chars().count() / 3).max(1);
    let nearest = known.split(", ").filter(near).min_by_key(|other| strsim::damerau_levenshtein(name, other));
    nearest.map(|other| format!("; did you mean `{other}`?")).unwrap_or_default()
}

/// Error for a message of serde, with a suggestion for a misspelled name.
fn described(path: String, message: String) -> Error {
    // "." is the whole document. A path may end in the unknown key itself.
    let message = match message.strip_prefix("unknown field `").and_then(|rest| rest.split_once('`')) {
        Some((name, rest)) => {
            let known: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
            let (meant, expected) = (meant(name, &known.join(", ")), rest.trim_start_matches(", "));
            format!("unknown field `{name}`{}{expected}", if meant.is_empty() { ", ".into() } else { meant + " " })
        }
        None => message,
    };
    Error::Format { message: if path == "." { message } else { format!("{path}: {message}") } }
}

/// Reads a value from JSON text. Errors name the field.
///
/// # Errors
/// [`Error::Format`] for malformed JSON, wrong types, unknown or missing keys.
pub fn from_json<T: serde::de::DeserializeOwned>(text: &str) -> Result<T> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut json).map_err(|e| described(e.path().to_string(), e.into_inner().to_string()))?;
    json.end()?;
    Ok(value)
}

/// Reads a value from a JSON tree. Errors name the field.
///
/// # Errors
/// [`Error::Format`] for wrong types, unknown or missing keys.
#[cfg(feature = "python")]
pub fn from_value<T: serde::de::DeserializeOwned>(tree: serde_json::Value) -> Result<T> {
    serde_path_to_error::deserialize(tree).map_err(|e| described(e.path().to_string(), e.into_inner().to_string()))
}

/// Reads a value from TOML text. Errors name line, column and field.
///
/// # Errors
/// [`Error::Format`] for malformed TOML, wrong types, unknown or missing keys.
pub fn from_toml<T: serde::de::DeserializeOwned>(text: &str) -> Result<T> {
    let place = |e: &toml::de::Error| {
        let before = e.span().map(|span| &text[..span.start.min(text.len())])?;
        let (line, column) = (before.matches('\n').count() + 1, before.chars().rev().take_while(|&c| c != '\n').count() + 1);
        Some(format!(" at line {line} column {column}"))
    };
    let with_place = |e: &toml::de::Error| format!("{}{}", e.message(), place(e).unwrap_or_default());
    let document = toml::Deserializer::parse(text).map_err(|e| Error::Format { message: with_place(&e) })?;
    serde_path_to_error::deserialize(document).map_err(|e| described(e.path().to_string(), with_place(e.inner())))
}

/// Indented JSON text of a value, ending in a newline.
///
/// # Errors
/// [`Error::Format`] for values that JSON cannot hold.
pub fn to_json<T: serde::Serialize>(value: &T) -> Result<String> {
    Ok(serde_json::to_string_pretty(value)? + "\n")
}

/// Writes a value as TOML text.
///
/// # Errors
/// [`Error::Format`] for values that TOML cannot represent.
pub fn to_toml<T: serde::Serialize>(value: &T) -> Result<String> {
    toml::to_string(value).map_err(|e| Error::Format { message: e.to_string() })
}

/// Checks that a number is finite and inside `[low, high]`.
pub fn check_range(place: &str, value: f64, low: f64, high: f64) -> Result<()> {
    if value.is_finite() && value >= low && value <= high {
        Ok(())
    } else {
        Err(Error::invalid(place, value, format!("a number from {low} to {high}")))
    }
}

/// Checks a name that is printed: 1 to 64 characters, none of which moves the cursor or hides text.
pub fn check_name(place: &str, name: &str) -> Result<()> {
    let plain = |c: char| !c.is_control() && (c == '\'' || c == '"' || c == '\\' || c.escape_debug().count() == 1);
    if !name.is_empty() && name.chars().count() <= 64 && name.chars().all(plain) {
        return Ok(());
    }
    let shown: String = name.chars().take(64).collect();
    Err(Error::invalid(place, format!("\"{}\"", shown.escape_debug()), "1 to 64 characters that can be printed"))
}
