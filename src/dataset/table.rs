//! Tables of columns as Parquet files: written and read whole, byte for byte the same for the same values.

use crate::error::{Error, Result};
use crate::files;
use parquet::basic::{Compression, ConvertedType, Encoding, Repetition, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, Type};
use std::path::Path;
use std::sync::Arc;

/// Values of a column, one per row.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// 32-bit integers.
    Int(Vec<i32>),
    /// Single precision.
    Float(Vec<f32>),
    /// Double precision.
    Double(Vec<f64>),
    /// Text.
    Text(Vec<String>),
}

impl Values {
    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Values::Int(values) => values.len(),
            Values::Float(values) => values.len(),
            Values::Double(values) => values.len(),
            Values::Text(values) => values.len(),
        }
    }

    /// True if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name of the type.
    pub fn kind(&self) -> &'static str {
        match self {
            Values::Int(_) => "int32",
            Values::Float(_) => "float",
            Values::Double(_) => "double",
            Values::Text(_) => "text",
        }
    }

    /// Type in the file.
    fn physical(&self) -> Physical {
        match self {
            Values::Int(_) => Physical::INT32,
            Values::Float(_) => Physical::FLOAT,
            Values::Double(_) => Physical::DOUBLE,
            Values::Text(_) => Physical::BYTE_ARRAY,
        }
    }

    /// Number in a row; NaN for text.
    pub fn number(&self, row: usize) -> f64 {
        match self {
            Values::Int(values) => f64::from(values[row]),
            Values::Float(values) => f64::from(values[row]),
            Values::Double(values) => values[row],
            Values::Text(_) => f64::NAN,
        }
    }
}

/// Column with its name.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name, with the unit at its end.
    pub name: String,
    /// Values.
    pub values: Values,
}

/// Table of columns of equal length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// Columns.
    pub columns: Vec<Column>,
    /// Metadata of the file: keys and texts.
    pub metadata: Vec<(String, String)>,
}

/// Error of the library about a file.
fn failed(path: &Path) -> impl Fn(ParquetError) -> Error + '_ {
    |error| Error::Format { message: error.to_string() }.in_file(path, None)
}

impl Table {
    /// Adds a column.
    pub fn add(&mut self, name: impl Into<String>, values: Values) {
        self.columns.push(Column { name: name.into(), values });
    }

    /// Column with a name.
    pub fn column(&self, name: &str) -> Option<&Values> {
        self.columns.iter().find(|column| column.name == name).map(|column| &column.values)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.values.len())
    }

    /// Content of the file. Numbers are split by bytes before compression, texts and integers have dictionaries.
    ///
    /// # Errors
    /// [`Error::Format`] for an error of the library.
    pub fn bytes(&self) -> Result<Vec<u8>> {
        self.written().map_err(|error| Error::Format { message: error.to_string() })
    }

    fn written(&self) -> std::result::Result<Vec<u8>, ParquetError> {
        let metadata = self.metadata.iter().map(|(key, text)| KeyValue::new(key.clone(), text.clone())).collect();
        let mut properties = WriterProperties::builder()
            .set_created_by(format!("cregopt version {}", env!("CARGO_PKG_VERSION")))
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(metadata));
        let mut fields = Vec::new();
        for Column { name, values } in &self.columns {
            let field = Type::primitive_type_builder(name, values.physical()).with_repetition(Repetition::REQUIRED);
            let field = if matches!(values, Values::Text(_)) { field.with_converted_type(ConvertedType::UTF8) } else { field };
            fields.push(Arc::new(field.build()?));
            if matches!(values, Values::Float(_) | Values::Double(_)) {
                let path = ColumnPath::new(vec![name.clone()]);
                properties =
                    properties.set_column_dictionary_enabled(path.clone(), false).set_column_encoding(path, Encoding::BYTE_STREAM_SPLIT);
            }
        }
        let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
        let mut bytes = Vec::new();
        let mut writer = SerializedFileWriter::new(&mut bytes, schema, Arc::new(properties.build()))?;
        let mut group = writer.next_row_group()?;
        for Column { values, .. } in &self.columns {
            let Some(mut column) = group.next_column()? else { break };
            match values {
                Values::Int(values) => column.typed::<Int32Type>().write_batch(values, None, None)?,
                Values::Float(values) => column.typed::<FloatType>().write_batch(values, None, None)?,
                Values::Double(values) => column.typed::<DoubleType>().write_batch(values, None, None)?,
                Values::Text(values) => {
                    let values: Vec<ByteArray> = values.iter().map(|text| text.as_str().into()).collect();
                    column.typed::<ByteArrayType>().write_batch(&values, None, None)?
                }
            };
            column.close()?;
        }
        group.close()?;
        writer.close()?;
        Ok(bytes)
    }

    /// Reads a file with columns of the types of [`Values`].
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses; [`Error::InFile`] for another file, and for a column of another type.
    pub fn read(path: &Path) -> Result<Table> {
        let file = std::fs::File::open(path).map_err(|source| Error::Io { action: "read", path: path.to_owned(), source })?;
        let length = file.metadata().map_or(0, |m| m.len());
        if length > files::MAX_FILE {
            return Err(Error::invalid("file size", length, format!("at most {} bytes", files::MAX_FILE)).in_file(path, None));
        }
        let reader = SerializedFileReader::new(file).map_err(failed(path))?;
        let about = reader.metadata().file_metadata();
        let metadata = about.key_value_metadata().into_iter().flatten();
        let metadata = metadata.map(|pair| (pair.key.clone(), pair.value.clone().unwrap_or_default())).collect();
        let names = about.schema_descr().columns().iter().map(|column| column.path().string());
        let mut table = Table { columns: Vec::new(), metadata };
        for (index, name) in names.enumerate() {
            let values = Table::read_column(&reader, index, &name).map_err(|e| e.in_file(path, None))?;
            table.columns.push(Column { name, values });
        }
        let rows = table.rows();
        match table.columns.iter().find(|column| column.values.len() != rows) {
            Some(column) => {
                Err(Error::invalid(&column.name, format!("{} rows", column.values.len()), format!("{rows} rows")).in_file(path, None))
            }
            None => Ok(table),
        }
    }

    fn read_column(reader: &SerializedFileReader<std::fs::File>, index: usize, name: &str) -> Result<Values> {
        let error = |error: ParquetError| Error::Format { message: format!("{name}: {error}") };
        let mut found: Option<Values> = None;
        for group in 0..reader.num_row_groups() {
            let group = reader.get_row_group(group).map_err(error)?;
            let rows = group.metadata().num_rows().max(0) as usize;
            let more = match group.get_column_reader(index).map_err(error)? {
                ColumnReader::Int32ColumnReader(column) => Values::Int(all(column, rows).map_err(error)?),
                ColumnReader::FloatColumnReader(column) => Values::Float(all(column, rows).map_err(error)?),
                ColumnReader::DoubleColumnReader(column) => Values::Double(all(column, rows).map_err(error)?),
                ColumnReader::ByteArrayColumnReader(column) => {
                    let texts = all(column, rows).map_err(error)?;
                    let text = |bytes: &ByteArray| bytes.as_utf8().map(str::to_owned).map_err(error);
                    Values::Text(texts.iter().map(text).collect::<Result<_>>()?)
                }
                _ => return Err(Error::invalid(name, "another type", "int32, float, double or text")),
            };
            match (&mut found, more) {
                (None, more) => found = Some(more),
                (Some(Values::Int(all)), Values::Int(more)) => all.extend(more),
                (Some(Values::Float(all)), Values::Float(more)) => all.extend(more),
                (Some(Values::Double(all)), Values::Double(more)) => all.extend(more),
                (Some(Values::Text(all)), Values::Text(more)) => all.extend(more),
                _ => return Err(Error::invalid(name, "several types", "one type")),
            }
        }
        found.ok_or_else(|| Error::invalid(name, "no row group", "at least one"))
    }
}

/// All values of a column of a row group.
fn all<T: DataType>(mut column: ColumnReaderImpl<T>, rows: usize) -> std::result::Result<Vec<T::T>, ParquetError> {
    let mut values = Vec::new();
    while values.len() < rows {
        let (records, _, _) = column.read_records(rows - values.len(), None, None, &mut values)?;
        if records == 0 {
            break;
        }
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_read_back_and_its_bytes_repeat() {
        let mut table = Table { metadata: vec![("licence".into(), "none".into())], ..Table::default() };
        table.add("motion", Values::Int((0..1000).map(|i| i / 10).collect()));
        table.add("LF_force_z_N", Values::Float((0..1000).map(|i| (0.1 * i as f32).sin()).collect()));
        table.add("time_s", Values::Double((0..1000).map(|i| 0.02 * f64::from(i)).collect()));
        table.add("family", Values::Text((0..1000).map(|i| format!("gait {}", i % 3)).collect()));
        let bytes = table.bytes().unwrap();
        assert_eq!(bytes, table.bytes().unwrap());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.parquet");
        files::write_bytes(&path, &bytes).unwrap();
        assert_eq!(Table::read(&path).unwrap(), table);
        // A file that was cut off is refused by name.
        files::write_bytes(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(Table::read(&path).unwrap_err().to_string().contains("table.parquet"));
    }

    #[test]
    fn a_table_without_rows_is_read_back() {
        let mut table = Table::default();
        table.add("motion", Values::Int(vec![]));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty.parquet");
        files::write_bytes(&path, &table.bytes().unwrap()).unwrap();
        assert_eq!(Table::read(&path).unwrap().rows(), 0);
    }
}
