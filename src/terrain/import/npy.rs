//! Height maps as NumPy files: axis 0 along x, axis 1 along y.

use super::{MOST, Map, Placement};
use crate::error::{Error, Result};
use std::io::Cursor;

/// Reads a matrix of floats or integers.
pub(super) fn map(bytes: &[u8], _: &Placement) -> Result<Map> {
    let format = |e: std::io::Error| Error::Format { message: format!("not an NPY file: {e}") };
    let header = npyz::NpyHeader::from_reader(Cursor::new(bytes)).map_err(format)?;
    let &[rows, columns] = header.shape() else {
        return Err(Error::invalid("height map", format!("{} dimensions", header.shape().len()), "2: x and y"));
    };
    if !(2..=MOST as u64).contains(&rows) || !(2..=MOST as u64).contains(&columns) {
        return Err(Error::invalid("height map", format!("{rows} x {columns} samples"), format!("2 x 2 to {MOST} x {MOST}")));
    }
    let by_columns = header.order() == npyz::Order::Fortran;
    let file = || npyz::NpyFile::new(Cursor::new(bytes)).map_err(format);
    let kind = header.dtype().descr();
    type File<'a> = npyz::NpyFile<Cursor<&'a [u8]>>;
    type Values = Option<std::io::Result<Vec<f64>>>;
    fn values<T: npyz::Deserialize + Into<f64>>(file: File) -> Values {
        let data = file.data::<T>().ok()?;
        Some(data.map(|value| value.map(Into::into)).collect())
    }
    let readers: [fn(File) -> Values; 8] =
        [values::<f64>, values::<f32>, values::<i32>, values::<u32>, values::<i16>, values::<u16>, values::<i8>, values::<u8>];
    let mut flat = None;
    for reader in readers {
        flat = reader(file()?);
        if flat.is_some() {
            break;
        }
    }
    let flat =
        flat.ok_or_else(|| Error::invalid("height map", format!("numbers of type {kind}"), "floats, or integers of at most 32 bits"))?;
    let flat = flat.map_err(format)?;
    let (rows, columns) = (rows as usize, columns as usize);
    if flat.len() != rows * columns {
        return Err(Error::invalid("height map", format!("{} numbers", flat.len()), format!("{rows} x {columns}")));
    }
    let at = |i: usize, j: usize| if by_columns { flat[j * rows + i] } else { flat[i * columns + j] };
    Ok(Map::unplaced((0..rows).map(|i| (0..columns).map(|j| at(i, j)).collect()).collect()))
}
