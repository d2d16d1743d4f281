//! MCAP files.

use crate::error::{Error, Result};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::Cursor;

/// MCAP file in memory.
pub(super) struct Log(Writer<Cursor<Vec<u8>>>);

fn failed(error: mcap::McapError) -> Error {
    Error::Format { message: format!("MCAP: {error}") }
}

impl Log {
    /// Empty file.
    ///
    /// * `profile` - conventions of its topics, such as `ros2`; may be empty
    pub fn new(profile: &str) -> Result<Log> {
        let options = WriteOptions::new().compression(None).profile(profile).library(concat!("cregopt ", env!("CARGO_PKG_VERSION")));
        Writer::with_options(Cursor::new(Vec::new()), options).map(Log).map_err(failed)
    }

    /// Adds a topic, and returns its channel.
    ///
    /// * `schema` - name, encoding and text of the schema
    /// * `encoding` - encoding of the messages
    pub fn channel(&mut self, topic: &str, schema: [&str; 3], encoding: &str) -> Result<u16> {
        let [name, schema_encoding, text] = schema;
        let schema = self.0.add_schema(name, schema_encoding, text.as_bytes()).map_err(failed)?;
        self.0.add_channel(schema, topic, encoding, &BTreeMap::new()).map_err(failed)
    }

    /// Adds a message.
    ///
    /// * `time` - s
    pub fn add(&mut self, channel_id: u16, sequence: u32, time: f64, message: &[u8]) -> Result<()> {
        let log_time = (time * 1e9).round() as u64;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.0.write_to_known_channel(&header, message).map_err(failed)
    }

    /// Bytes of the file.
    pub fn finish(mut self) -> Result<Vec<u8>> {
        self.0.finish().map_err(failed)?;
        Ok(self.0.into_inner().into_inner())
    }
}
