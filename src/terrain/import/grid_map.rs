//! Maps of ANYbotics' `grid_map`: messages `grid_map_msgs/msg/GridMap` in MCAP.
//!
//! The conventions are those of `grid_map_core` and `grid_map_ros`: the pose is the centre of the map. A layer is a matrix with rows along
//! x and columns along y, stored by columns. Its indices grow against the axes, so that the first cell has the largest x and y; they start
//! at the index (`outer_start_index`, `inner_start_index`) of a circular buffer. The size of the matrix is the rounded quotient of length
//! and resolution. NaN is an unknown height. The height of the pose is ignored, as in `grid_map_ros`, and a rotation is refused.

use super::{MOST, Map, Placement};
use crate::cdr::Reader;
use crate::error::{Error, Result};
use crate::files::MAX_FILE;
use mcap::read::LinearReader;
use mcap::records::Record;
use std::collections::BTreeMap;
use std::io::Read;

/// Layer by default: that of `elevation_mapping`.
const LAYER: &str = "elevation";

/// Names of the message type in ROS 2, and its short form.
const SCHEMAS: [&str; 2] = ["grid_map_msgs/msg/GridMap", "grid_map_msgs/GridMap"];

/// Largest part of a quaternion along x, y and z that counts as no rotation.
const UPRIGHT: f64 = 1e-6;

/// Reads the last map of a topic.
pub(super) fn map(bytes: &[u8], placement: &Placement) -> Result<Map> {
    let (topic, message) = last(bytes, placement.topic.as_deref())?;
    let map = GridMap::read(&message, placement.layer.as_deref().unwrap_or(LAYER)).map_err(|e| e.within(format!("topic {topic}")))?;
    if let Some(cell) = placement.cell {
        let limit = format!("left out: the resolution of the map is {} m", map.resolution);
        return Err(Error::invalid("--cell", cell, limit));
    }
    let note = format!("layer `{}` of {topic} at {} s, frame `{}`", map.layer, map.stamp, map.frame);
    Ok(Map { note, place: Some((map.first(), map.resolution)), heights: map.heights() })
}

fn failed(error: mcap::McapError) -> Error {
    Error::Format { message: format!("MCAP: {error}") }
}

/// Records of a chunk, not compressed.
fn decompressed(compression: &str, data: &[u8], size: u64) -> Result<Vec<u8>> {
    let refuse = |value: String, limit: &str| Err(Error::invalid("MCAP chunk", value, limit));
    if size > MAX_FILE {
        return refuse(format!("{size} bytes"), &format!("at most {MAX_FILE} bytes"));
    }
    let mut records = Vec::new();
    let read = match compression {
        "" => return Ok(data.to_vec()),
        "zstd" => match ruzstd::decoding::StreamingDecoder::new(data) {
            Ok(decoder) => decoder.take(size).read_to_end(&mut records),
            Err(error) => return refuse(format!("zstd: {error}"), "compressed by zstd"),
        },
        "lz4" => lz4_flex::frame::FrameDecoder::new(data).take(size).read_to_end(&mut records),
        other => return refuse(format!("compressed by `{}`", other.escape_debug()), "compressed by zstd or lz4, or not compressed"),
    };
    match read {
        Ok(length) if length as u64 == size => Ok(records),
        Ok(length) => refuse(format!("{length} bytes"), &format!("{size} bytes, as its header states")),
        Err(error) => refuse(format!("{compression}: {error}"), &format!("compressed by {compression}")),
    }
}

/// Messages of a file with their topics.
#[derive(Default)]
struct Messages {
    /// Names by number.
    schemas: BTreeMap<u16, String>,
    /// Topic, number of the schema and encoding, by number.
    channels: BTreeMap<u16, (String, u16, String)>,
    /// Time and last message of each topic with grid maps.
    found: BTreeMap<String, (u64, Vec<u8>)>,
    /// Other topics, with their schemas.
    others: BTreeMap<String, String>,
}

impl Messages {
    /// Adds a record.
    ///
    /// * `topic` - topic to read, if it is chosen
    fn add(&mut self, record: Record, topic: Option<&str>) -> Result<()> {
        match record {
            Record::Schema { header, .. } => drop(self.schemas.insert(header.id, header.name)),
            Record::Channel(channel) => {
                drop(self.channels.insert(channel.id, (channel.topic, channel.schema_id, channel.message_encoding)))
            }
            Record::Message { header, data } => {
                let Some((name, schema, encoding)) = self.channels.get(&header.channel_id) else {
                    return Err(Error::invalid("MCAP message", format!("channel {}", header.channel_id), "a channel that comes before it"));
                };
                let schema = self.schemas.get(schema).map_or("", String::as_str);
                if !SCHEMAS.contains(&schema) || topic.is_some_and(|topic| topic != name) {
                    self.others.insert(name.clone(), schema.into());
                } else if encoding != "cdr" {
                    return Err(Error::invalid(format!("topic {name}"), format!("encoding `{encoding}`"), "`cdr`, that of ROS 2"));
                } else if self.found.get(name).is_none_or(|(time, _)| *time <= header.log_time) {
                    self.found.insert(name.clone(), (header.log_time, data.into_owned()));
                }
            }
            Record::Chunk { header, data } => {
                let records = decompressed(&header.compression, &data, header.uncompressed_size)?;
                for record in LinearReader::sans_magic(&records) {
                    self.add(record.map_err(failed)?, topic)?;
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// Topic and last message of the grid maps in a file.
fn last(bytes: &[u8], topic: Option<&str>) -> Result<(String, Vec<u8>)> {
    let mut messages = Messages::default();
    for record in LinearReader::new(bytes).map_err(failed)? {
        messages.add(record.map_err(failed)?, topic)?;
    }
    let Messages { mut found, others, .. } = messages;
    let topics = found.keys().cloned().collect::<Vec<_>>().join(", ");
    let listed = others.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect::<Vec<_>>().join(", ");
    match (found.len(), found.pop_first(), topic) {
        (1, Some((topic, (_, message))), _) => Ok((topic, message)),
        (0, _, Some(topic)) => Err(Error::Unknown { what: "topic with grid maps", name: topic.into(), known: listed }),
        (0, ..) => Err(Error::invalid("MCAP", format!("topics {listed}"), format!("with a topic of type {}", SCHEMAS[0]))),
        _ => Err(Error::invalid("MCAP", format!("grid maps of the topics {topics}"), "of one topic, or one chosen by --topic")),
    }
}

/// One layer of a message.
struct GridMap {
    /// Time, s.
    stamp: f64,
    frame: String,
    /// Side of a cell, m.
    resolution: f64,
    /// Extent along x and y, m.
    length: [f64; 2],
    /// Centre (x, y), m.
    centre: [f64; 2],
    layer: String,
    /// Rows (along x) and columns (along y).
    size: [usize; 2],
    /// True if the elements of a row are adjacent.
    by_rows: bool,
    data: Vec<f32>,
    /// Row and column of the cell with the largest x and y.
    start: [usize; 2],
}

impl GridMap {
    fn read(message: &[u8], layer: &str) -> Result<GridMap> {
        let mut cdr = Reader::new(message)?;
        let stamp = f64::from(cdr.i32("header.stamp.sec")?) + 1e-9 * f64::from(cdr.u32("header.stamp.nanosec")?);
        let frame = cdr.string("header.frame_id")?;
        let resolution = cdr.f64("info.resolution")?;
        let length = [cdr.f64("info.length_x")?, cdr.f64("info.length_y")?];
        let [x, y, _] = [cdr.f64("info.pose.position.x")?, cdr.f64("info.pose.position.y")?, cdr.f64("info.pose.position.z")?];
        for axis in ["x", "y", "z"] {
            let field = format!("info.pose.orientation.{axis}");
            let part = cdr.f64(&field)?;
            if part.is_nan() || part.abs() > UPRIGHT {
                return Err(Error::invalid(field, part, "0: a grid map is parallel to its frame"));
            }
        }
        cdr.f64("info.pose.orientation.w")?;
        let names = cdr.sequence("layers", |cdr, i| cdr.string(&format!("layers[{i}]")))?;
        cdr.sequence("basic_layers", |cdr, i| cdr.string(&format!("basic_layers[{i}]")))?;
        let number = names.iter().position(|name| name == layer);
        let number = number.ok_or_else(|| Error::Unknown { what: "layer", name: layer.into(), known: names.join(", ") })?;
        let arrays = cdr.sequence("data", |cdr, i| {
            let place = format!("data[{i}]");
            let dims = cdr.sequence(&format!("{place}.layout.dim"), |cdr, d| {
                let place = format!("{place}.layout.dim[{d}]");
                let label = cdr.string(&format!("{place}.label"))?;
                let size = cdr.u32(&format!("{place}.size"))? as usize;
                cdr.u32(&format!("{place}.stride"))?;
                Ok((label, size))
            })?;
            cdr.u32(&format!("{place}.layout.data_offset"))?;
            let data = cdr.f32s(&format!("{place}.data"))?;
            // The data of other layers are not kept.
            Ok((dims, if i == number { data } else { Vec::new() }))
        })?;
        let start = [usize::from(cdr.u16("outer_start_index")?), usize::from(cdr.u16("inner_start_index")?)];
        let count = arrays.len();
        let Some((dims, data)) = arrays.into_iter().nth(number) else {
            return Err(Error::invalid("data", format!("{count} arrays"), format!("{}, one per layer", names.len())));
        };
        let place = format!("data[{number}].layout.dim");
        let (by_rows, size) = match dims.as_slice() {
            [(first, columns), (second, rows)] if first == "column_index" && second == "row_index" => (false, [*rows, *columns]),
            [(first, rows), (second, columns)] if first == "row_index" && second == "column_index" => (true, [*rows, *columns]),
            _ => {
                let labels = dims.iter().map(|(label, _)| label.as_str()).collect::<Vec<_>>().join(", ");
                return Err(Error::invalid(
                    place,
                    format!("labels `{}`", labels.escape_debug()),
                    "`column_index, row_index`, or in reverse order",
                ));
            }
        };
        let map = GridMap { stamp, frame, resolution, length, centre: [x, y], layer: layer.into(), size, by_rows, data, start };
        map.check(&place)?;
        Ok(map)
    }

    /// Checks that sizes, lengths and start indices agree.
    fn check(&self, dims: &str) -> Result<()> {
        crate::error::check_range("info.resolution", self.resolution, 1e-3, 100.)?;
        for (axis, name) in ["x", "y"].iter().enumerate() {
            let (size, samples) = (self.size[axis], (self.length[axis] / self.resolution).round());
            if samples != size as f64 || !(2..=MOST).contains(&size) {
                let value = format!("{size} along {name}");
                return Err(Error::invalid(dims, value, format!("{samples}, which is length / resolution, and 2 to {MOST}")));
            }
            if self.start[axis] >= size {
                let field = ["outer_start_index", "inner_start_index"][axis];
                return Err(Error::invalid(field, self.start[axis], format!("0 to {}", size - 1)));
            }
            crate::error::check_range(&format!("info.pose.position.{name}"), self.centre[axis], -1000., 1000.)?;
        }
        let [rows, columns] = self.size;
        if self.data.len() != rows * columns {
            return Err(Error::invalid(
                dims.replace("layout.dim", "data"),
                format!("{} numbers", self.data.len()),
                format!("{rows} x {columns}"),
            ));
        }
        Ok(())
    }

    /// Position of the cell with the smallest x and y, m.
    fn first(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.centre[axis] - 0.5 * (self.size[axis] as f64 - 1.) * self.resolution)
    }

    /// Heights with x and y rising, `[rows along x][columns along y]`.
    fn heights(&self) -> Vec<Vec<f64>> {
        let [rows, columns] = self.size;
        let index = |axis: usize, rising: usize| (self.start[axis] + self.size[axis] - 1 - rising) % self.size[axis];
        let at = |row: usize, column: usize| self.data[if self.by_rows { row * columns + column } else { column * rows + row }];
        (0..rows).map(|i| (0..columns).map(|j| f64::from(at(index(0, i), index(1, j)))).collect()).collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::cdr::Writer;
    use std::io::Cursor;

    /// Parts of a message that the tests vary.
    #[derive(Clone)]
    pub struct Parts {
        length: [f64; 2],
        centre: [f64; 2],
        turn: f64,
        layers: Vec<&'static str>,
        labels: [&'static str; 2],
        /// Sizes of the first and second label.
        sizes: [u32; 2],
        data: Vec<Vec<f32>>,
        start: [u16; 2],
    }

    /// Map of 3 x 2 cells of 0.5 m around (1, -2) whose buffer begins at row 1, column 1. Height of the cell at x, y: `10 x + y`.
    fn parts() -> Parts {
        // By columns of the buffer. Rows have x = 1.5, 1, 0.5 from row 1 on, so row 0 has x = 0.5; columns have y = -1.75, -2.25 from column 1 on.
        let height = |x: f32, y: f32| 10. * x + y;
        let data = [-2.25, -1.75].into_iter().flat_map(|y| [0.5, 1.5, 1.].map(|x| height(x, y))).collect();
        Parts {
            length: [1.5, 1.],
            centre: [1., -2.],
            turn: 0.,
            layers: vec!["variance", "elevation"],
            labels: ["column_index", "row_index"],
            sizes: [2, 3],
            data: vec![vec![0.; 6], data],
            start: [1, 1],
        }
    }

    fn encoded(parts: &Parts) -> Vec<u8> {
        let mut cdr = Writer::new();
        cdr.i32(12);
        cdr.u32(500_000_000);
        cdr.string("odom");
        cdr.f64s(&[0.5, parts.length[0], parts.length[1], parts.centre[0], parts.centre[1], 7., 0., 0., parts.turn, 1.]);
        cdr.sequence(parts.layers.iter(), |cdr, layer| cdr.string(layer));
        cdr.sequence(["elevation"].iter(), |cdr, layer| cdr.string(layer));
        cdr.sequence(parts.data.iter(), |cdr, data| {
            cdr.sequence(parts.labels.iter().zip(parts.sizes), |cdr, (label, size)| {
                cdr.string(label);
                cdr.u32(size);
                cdr.u32(6);
            });
            cdr.u32(0);
            cdr.sequence(data.iter(), |cdr, value| cdr.u32(value.to_bits()));
        });
        cdr.u16(parts.start[0]);
        cdr.u16(parts.start[1]);
        cdr.finish()
    }

    pub fn message() -> Vec<u8> {
        encoded(&parts())
    }

    /// File with messages on one topic, one per second, and with another topic.
    pub fn file(messages: &[Vec<u8>]) -> Vec<u8> {
        written(&[("/elevation_mapping/map", messages)])
    }

    fn written(topics: &[(&str, &[Vec<u8>])]) -> Vec<u8> {
        let options = mcap::WriteOptions::new().compression(None).profile("ros2");
        let mut writer = mcap::Writer::with_options(Cursor::new(Vec::new()), options).unwrap();
        let schema = writer.add_schema("grid_map_msgs/msg/GridMap", "ros2msg", b"").unwrap();
        let other = writer.add_schema("std_msgs/msg/Bool", "ros2msg", b"bool data").unwrap();
        let other = writer.add_channel(other, "/on", "cdr", &BTreeMap::new()).unwrap();
        let header = |channel_id, log_time| mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: 0 };
        writer.write_to_known_channel(&header(other, 0), &[0, 1, 0, 0, 1]).unwrap();
        for (topic, messages) in topics {
            let channel = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
            for (second, message) in (0..).zip(*messages) {
                writer.write_to_known_channel(&header(channel, 1_000_000_000 * second), message).unwrap();
            }
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    fn read(parts: &Parts) -> Result<Map> {
        map(&file(&[encoded(parts)]), &Placement::default())
    }

    fn refused(file: &[u8], placement: &Placement) -> String {
        map(file, placement).err().map(|e| e.to_string()).unwrap_or_default()
    }

    #[test]
    fn indices_grow_against_the_axes_from_the_start_of_the_buffer() {
        let expected = [0.5, 1., 1.5].map(|x: f64| [-2.25, -1.75].map(|y| 10. * x + y));
        let map = read(&parts()).unwrap();
        assert_eq!(map.place, Some(([0.5, -2.25], 0.5)));
        assert_eq!(map.heights, expected);
        assert_eq!(map.note, "layer `elevation` of /elevation_mapping/map at 12.5 s, frame `odom`");
        // The elements by rows: only the labels and the order change.
        let by_rows = Parts {
            labels: ["row_index", "column_index"],
            sizes: [3, 2],
            data: vec![vec![], (0..3).flat_map(|row| [0, 1].map(|column| parts().data[1][column * 3 + row])).collect()],
            ..parts()
        };
        assert_eq!(read(&by_rows).unwrap().heights, expected);
        // Without a shift the first element has the largest x and y.
        let start = read(&Parts { start: [0, 0], ..parts() }).unwrap();
        assert_eq!(start.heights[2][1], f64::from(parts().data[1][0]));
        let hole = read(&Parts { data: vec![vec![], vec![f32::NAN; 6]], ..parts() }).unwrap();
        assert!(hole.heights.iter().flatten().all(|height| height.is_nan()));
    }

    #[test]
    fn the_last_map_of_the_chosen_topic_and_layer_is_read() {
        let later = Parts { data: vec![vec![1.; 6], vec![2.; 6]], ..parts() };
        let (one, two) = ([message(), encoded(&later)], [message()]);
        assert_eq!(map(&file(&one), &Placement::default()).unwrap().heights[0][0], 2.);
        let variance = Placement { layer: Some("variance".into()), ..Placement::default() };
        assert_eq!(map(&file(&one), &variance).unwrap().heights[0][0], 1.);
        let both = written(&[("/near", &one[..]), ("/far", &two[..])]);
        let error = refused(&both, &Placement::default());
        assert!(error.contains("grid maps of the topics /far, /near") && error.contains("--topic"), "{error}");
        let of = |topic: &str| Placement { topic: Some(topic.into()), ..Placement::default() };
        assert_eq!(map(&both, &of("/near")).unwrap().heights[0][0], 2.);
        assert_eq!(map(&both, &of("/far")).unwrap().heights[0][0], 2.75);
        let error = refused(&both, &of("/nea"));
        assert!(error.contains("unknown topic with grid maps `/nea`") && error.contains("/near"), "{error}");
        let error = refused(&file(&[message()]), &Placement { layer: Some("elevaton".into()), ..Placement::default() });
        assert!(error.contains("unknown layer `elevaton`; did you mean `elevation`?"), "{error}");
        let error = refused(&written(&[]), &Placement::default());
        assert!(error.contains("topics /on (std_msgs/msg/Bool), but it must be with a topic of type grid_map_msgs/msg/GridMap"), "{error}");
        let error = refused(&file(&[message()]), &Placement { cell: Some(0.1), ..Placement::default() });
        assert!(error.contains("--cell: 0.1, but it must be left out: the resolution of the map is 0.5 m"), "{error}");
    }

    #[test]
    fn contradictions_in_a_message_are_refused_with_the_field() {
        let cases = [
            (Parts { turn: 0.1, ..parts() }, "info.pose.orientation.z: 0.1, but it must be 0"),
            (Parts { length: [2., 1.], ..parts() }, "data[1].layout.dim: 3 along x, but it must be 4"),
            (Parts { start: [3, 0], ..parts() }, "outer_start_index: 3, but it must be 0 to 2"),
            (Parts { start: [0, 2], ..parts() }, "inner_start_index: 2, but it must be 0 to 1"),
            (Parts { labels: ["x", "y"], ..parts() }, "data[1].layout.dim: labels `x, y`"),
            (Parts { data: vec![vec![], vec![0.; 5]], ..parts() }, "data[1].data: 5 numbers, but it must be 3 x 2"),
            (Parts { data: vec![vec![]], ..parts() }, "data: 1 arrays, but it must be 2"),
            (Parts { centre: [f64::NAN, 0.], ..parts() }, "info.pose.position.x: NaN"),
        ];
        for (parts, part) in cases {
            let error = read(&parts).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.starts_with(&format!("topic /elevation_mapping/map: {part}")), "{error}");
        }
        let whole = message();
        let error = refused(&file(&[whole[..whole.len() - 2].to_vec()]), &Placement::default());
        assert!(error.contains("inner_start_index: 2 bytes at") && error.contains("of the message"), "{error}");
        let error = refused(&file(&[[&[0, 7], &whole[2..]].concat()]), &Placement::default());
        assert!(error.contains("header [0, 7, 0, 0]"), "{error}");
    }
}
