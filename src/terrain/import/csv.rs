//! Height maps as text: rows along x, columns along y.

use super::{MOST, Map, Placement};
use crate::error::{Error, Result};

/// Reads numbers separated by commas, semicolons or tabs. An empty field or `nan` is a hole; a first line of words is a header.
pub(super) fn map(bytes: &[u8], _: &Placement) -> Result<Map> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = bytes.split(|&b| b == b'\n').next().unwrap_or_default();
    let separator = [b',', b';', b'\t'].into_iter().max_by_key(|s| (first.iter().filter(|&b| b == s).count(), *s == b',')).unwrap_or(b',');
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).delimiter(separator).trim(csv::Trim::All).from_reader(bytes);
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut record = csv::ByteRecord::new();
    for number in 0.. {
        if !reader.read_byte_record(&mut record).map_err(|e| Error::Format { message: e.to_string() })? {
            break;
        }
        // The reader skips empty lines; the line number must count them.
        let read = &bytes[..bytes.len().min(reader.position().byte() as usize)];
        let line = || 1 + read.strip_suffix(b"\n").unwrap_or(read).iter().filter(|&&b| b == b'\n').count();
        let place = |column: usize| format!("line {}, column {}", line(), column + 1);
        let field = |(column, field): (usize, &[u8])| {
            let text = std::str::from_utf8(field).unwrap_or("?");
            if text.is_empty() {
                return Ok(f64::NAN);
            }
            text.parse::<f64>()
                .map_err(|_| Error::invalid(place(column), format!("`{}`", text.escape_debug()), "a height in m, or nothing"))
        };
        let row: Result<Vec<f64>> = record.iter().enumerate().map(field).collect();
        let row = match row {
            Err(_) if number == 0 && record.iter().all(|f| !f.is_empty() && f[0].is_ascii_alphabetic()) => continue,
            row => row?,
        };
        if let Some(columns) = rows.first().map(Vec::len)
            && columns != row.len()
        {
            return Err(Error::invalid(format!("line {}", line()), format!("{} columns", row.len()), format!("{columns} as in the first")));
        }
        if rows.len() == MOST {
            return Err(Error::invalid("height map", format!("more than {MOST} rows"), format!("at most {MOST}")));
        }
        rows.push(row);
    }
    Ok(Map::unplaced(rows))
}
