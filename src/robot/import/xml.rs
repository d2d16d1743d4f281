//! Elements and attributes of XML files, with errors that name the line, the element and the value.

use crate::error::{Error, Result};
use roxmltree::{Document, Node, ParsingOptions};

/// Largest file, bytes.
pub const MAX_FILE: usize = 64 << 20;
/// Largest number of elements, texts and comments in a file.
const MAX_NODES: u32 = 4_000_000;
/// Largest absolute value of a number in a file, in its unit.
const LARGEST: f64 = 1e9;

/// Elements whose names say where another one is.
const OWNERS: [&str; 4] = ["link", "joint", "body", "geom"];

/// Parses a text.
///
/// * `format` - name of the format, for messages
///
/// # Errors
/// [`Error::Format`] for text that is not XML; [`Error::Invalid`] for a text that is too long.
pub fn document<'a>(text: &'a str, format: &str) -> Result<Document<'a>> {
    if text.len() > MAX_FILE {
        return Err(Error::invalid(format!("size of {format}"), format!("{} bytes", text.len()), format!("at most {MAX_FILE} bytes")));
    }
    if text.trim().is_empty() {
        return Err(Error::Format { message: format!("the file is empty, but {format} was expected") });
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(|e| Error::Format { message: format!("not XML: {e}") })
}

/// Outermost element, which must have a name.
pub fn outermost<'a, 'i>(document: &'a Document<'i>, format: &str, name: &str) -> Result<Node<'a, 'i>> {
    let root = document.root_element();
    match root.tag_name().name() {
        found if found == name => Ok(root),
        found => Err(Error::invalid("outermost element", format!("<{}>", shortened(found)), format!("<{name}>, as of {format}"))),
    }
}

/// Child elements with a name.
pub fn elements<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.is_element() && child.tag_name().name() == name)
}

/// First child element with a name.
pub fn element<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    elements(node, name).next()
}

/// Beginning of a text, for an error message.
pub fn shortened(text: &str) -> String {
    let mut shown: String = text.chars().take(40).collect();
    if shown.len() < text.len() {
        shown += "...";
    }
    shown.escape_debug().to_string()
}

/// Line and element, and the innermost element with a name that contains it.
pub fn place(node: Node) -> String {
    let (line, tag) = (line(node), shortened(node.tag_name().name()));
    let named = |node: &Node| OWNERS.contains(&node.tag_name().name()) && node.has_attribute("name");
    match node.ancestors().find(named) {
        None => format!("line {line}, <{tag}>"),
        Some(owner) => {
            let name = shortened(owner.attribute("name").unwrap_or_default());
            let inner = if owner == node { String::new() } else { format!(", <{tag}>") };
            format!("line {line}, {} `{name}`{inner}", owner.tag_name().name())
        }
    }
}

/// Line at which an element begins.
pub fn line(node: Node) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// First child element with a name, which must exist.
pub fn required<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Result<Node<'a, 'i>> {
    element(node, name).ok_or_else(|| Error::invalid(format!("{}, <{name}>", place(node)), "missing", "present"))
}

/// Value of an attribute, which must be given.
pub fn text<'a>(node: Node<'a, '_>, attribute: &str) -> Result<&'a str> {
    node.attribute(attribute).ok_or_else(|| Error::invalid(format!("{}, `{attribute}`", place(node)), "missing", "given"))
}

/// Value of `name`, which must not be empty.
pub fn name(node: Node) -> Result<String> {
    let name = text(node, "name")?;
    if name.trim().is_empty() { Err(Error::invalid(format!("{}, `name`", place(node)), "\"\"", "a name")) } else { Ok(name.into()) }
}

/// Parses a number. If `infinite` is set, as for joint limits, numbers beyond the largest one become infinite.
pub fn number(node: Node, attribute: &str, text: &str, infinite: bool) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(v) if v.abs() <= LARGEST => Ok(v),
        Ok(v) if infinite && !v.is_nan() => Ok(v.signum() * f64::INFINITY),
        _ => {
            let limit = format!("a number from {} to {LARGEST}", -LARGEST);
            Err(Error::invalid(format!("{}, `{attribute}`", place(node)), format!("\"{}\"", shortened(text)), limit))
        }
    }
}

/// A number of numbers in an attribute, or the default if it is absent.
pub fn numbers<const N: usize>(node: Node, attribute: &str, default: [f64; N]) -> Result<[f64; N]> {
    let Some(text) = node.attribute(attribute) else { return Ok(default) };
    let parts: Vec<&str> = text.split_whitespace().take(N + 1).collect();
    if parts.len() != N {
        return Err(Error::invalid(format!("{}, `{attribute}`", place(node)), format!("\"{}\"", shortened(text)), format!("{N} numbers")));
    }
    let mut values = default;
    for (value, part) in values.iter_mut().zip(parts) {
        *value = number(node, attribute, part, false)?;
    }
    Ok(values)
}

/// All numbers in an attribute, as many as there are. It may be absent.
pub fn list(node: Node, attribute: &str) -> Result<Vec<f64>> {
    node.attribute(attribute).unwrap_or_default().split_whitespace().map(|part| number(node, attribute, part, false)).collect()
}

/// A mandatory number.
pub fn scalar(node: Node, attribute: &str) -> Result<f64> {
    number(node, attribute, text(node, attribute)?, false)
}

/// A mandatory size, zero or positive.
pub fn size(node: Node, attribute: &str) -> Result<f64> {
    let value = scalar(node, attribute)?;
    if value >= 0. { Ok(value) } else { Err(Error::invalid(format!("{}, `{attribute}`", place(node)), value, "not negative")) }
}
