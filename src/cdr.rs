//! CDR, the encoding of ROS 2 messages: four bytes that state the byte order, then the fields of a message in order. A number is aligned to
//! its size, counted from the end of these four bytes.

#[cfg(feature = "import")]
use crate::error::{Error, Result};

/// Length of the header, bytes.
const HEADER: usize = 4;

/// Writer of a message with the least significant byte first.
pub struct Writer(Vec<u8>);

impl Writer {
    /// Message with a header and no fields yet.
    pub fn new() -> Writer {
        Writer(vec![0, 1, 0, 0])
    }

    /// Whole message.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }

    /// Aligns to the size of a number and adds it.
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        self.0.resize((self.0.len() - HEADER).next_multiple_of(N) + HEADER, 0);
        self.0.extend(bytes);
    }

    /// Adds a truth value.
    pub fn bool(&mut self, value: bool) {
        self.0.push(value.into());
    }

    /// Adds an unsigned integer of 16 bits.
    #[cfg(all(test, feature = "import"))]
    pub fn u16(&mut self, value: u16) {
        self.number(value.to_le_bytes());
    }

    /// Adds an unsigned integer, or the length of a sequence.
    pub fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    /// Adds a signed integer.
    pub fn i32(&mut self, value: i32) {
        self.number(value.to_le_bytes());
    }

    /// Adds numbers of 64 bits, such as those of a vector.
    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.number(value.to_le_bytes()));
    }

    /// Adds a text.
    pub fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.bytes().chain([0]));
    }

    /// Adds the length of a sequence and its items.
    pub fn sequence<T>(&mut self, items: impl ExactSizeIterator<Item = T>, mut add: impl FnMut(&mut Writer, T)) {
        self.u32(items.len() as u32);
        items.for_each(|item| add(self, item));
    }
}

/// Reader of a message. Every function takes the name of the field for errors.
#[cfg(feature = "import")]
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

#[cfg(feature = "import")]
impl<'a> Reader<'a> {
    /// Reader behind the header.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another encoding, such as that of version 2 with optional fields.
    pub fn new(message: &'a [u8]) -> Result<Reader<'a>> {
        let big_endian = match message {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            _ => {
                let shown = &message[..message.len().min(HEADER)];
                return Err(Error::invalid("message", format!("header {shown:?}"), "[0, 0, _, _] or [0, 1, _, _], that of plain CDR"));
            }
        };
        Ok(Reader { bytes: &message[HEADER..], at: 0, big_endian })
    }

    fn take(&mut self, field: &str, count: usize, align: usize) -> Result<&'a [u8]> {
        let start = self.at.next_multiple_of(align);
        let part = start.checked_add(count).and_then(|end| self.bytes.get(start..end)).ok_or_else(|| {
            let length = self.bytes.len();
            Error::invalid(field, format!("{count} bytes at {start}"), format!("within the {length} bytes of the message"))
        })?;
        self.at = start + count;
        Ok(part)
    }

    fn number<const N: usize>(&mut self, field: &str) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(field, N, N)?);
        if self.big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// Unsigned integer of 16 bits.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the message ends before it.
    pub fn u16(&mut self, field: &str) -> Result<u16> {
        self.number(field).map(u16::from_le_bytes)
    }

    /// Unsigned integer of 32 bits, and length of a sequence.
    ///
    /// # Errors
    /// See [`Reader::u16`].
    pub fn u32(&mut self, field: &str) -> Result<u32> {
        self.number(field).map(u32::from_le_bytes)
    }

    /// Signed integer of 32 bits.
    ///
    /// # Errors
    /// See [`Reader::u16`].
    pub fn i32(&mut self, field: &str) -> Result<i32> {
        self.number(field).map(i32::from_le_bytes)
    }

    /// Number of 64 bits.
    ///
    /// # Errors
    /// See [`Reader::u16`].
    pub fn f64(&mut self, field: &str) -> Result<f64> {
        self.number(field).map(f64::from_le_bytes)
    }

    /// Text.
    ///
    /// # Errors
    /// See [`Reader::u16`].
    pub fn string(&mut self, field: &str) -> Result<String> {
        let length = self.u32(field)? as usize;
        let bytes = self.take(field, length, 1)?;
        Ok(String::from_utf8_lossy(bytes.strip_suffix(b"\0").unwrap_or(bytes)).into_owned())
    }

    /// Sequence of numbers of 32 bits.
    ///
    /// # Errors
    /// See [`Reader::u16`].
    pub fn f32s(&mut self, field: &str) -> Result<Vec<f32>> {
        let count = self.u32(field)? as usize;
        let bytes = self.take(field, count.saturating_mul(4), if count == 0 { 1 } else { 4 })?;
        let read = if self.big_endian { f32::from_be_bytes } else { f32::from_le_bytes };
        Ok(bytes.chunks_exact(4).map(|b| read([b[0], b[1], b[2], b[3]])).collect())
    }

    /// Sequence of items, each read by a function that receives its number.
    ///
    /// # Errors
    /// Errors of the function, and see [`Reader::u16`].
    pub fn sequence<T>(&mut self, field: &str, mut item: impl FnMut(&mut Self, usize) -> Result<T>) -> Result<Vec<T>> {
        (0..self.u32(field)? as usize).map(|number| item(self, number)).collect()
    }
}
