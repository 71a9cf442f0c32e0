//! Tables of named columns as uncompressed Parquet files, readable by pandas, Polars, DuckDB and Rerun.

use crate::{CoreError, InputError, atomic};
use parquet::basic::{LogicalType, Repetition, Type as PhysicalType};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use std::path::Path;
use std::sync::Arc;

/// The values of one column, without missing values.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Parquet DOUBLE.
    F64(Vec<f64>),
    /// Parquet INT32.
    I32(Vec<i32>),
    /// Parquet BYTE_ARRAY annotated as STRING.
    Text(Vec<String>),
}

impl Column {
    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::F64(v) => v.len(),
            Self::I32(v) => v.len(),
            Self::Text(v) => v.len(),
        }
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn field(&self, name: &str) -> Result<Type, ParquetError> {
        let (physical, logical) = match self {
            Self::F64(_) => (PhysicalType::DOUBLE, None),
            Self::I32(_) => (PhysicalType::INT32, None),
            Self::Text(_) => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        };
        Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(logical)
            .build()
    }
}

/// Writes a table atomically. The same columns give the same bytes.
///
/// # Errors
/// [`CoreError::Write`] when the file cannot be written, or when the columns differ in length.
pub fn write_table<N: AsRef<str>>(path: &Path, columns: &[(N, Column)]) -> Result<(), CoreError> {
    // The writer is compiled here, not in every crate that calls this.
    let columns: Vec<(&str, &Column)> =
        columns.iter().map(|(name, column)| (name.as_ref(), column)).collect();
    let bytes = encode(&columns).map_err(|e| CoreError::Write {
        path: path.to_owned(),
        source: std::io::Error::new(std::io::ErrorKind::InvalidData, e),
    })?;
    atomic::write_bytes(path, &bytes)
}

fn encode(columns: &[(&str, &Column)]) -> Result<Vec<u8>, ParquetError> {
    let rows = columns.first().map_or(0, |(_, c)| c.len());
    if let Some((name, column)) = columns.iter().find(|(_, c)| c.len() != rows) {
        return Err(ParquetError::General(format!("column `{name}` has {} rows, not {rows}", column.len())));
    }
    let fields =
        columns.iter().map(|(name, c)| c.field(name).map(Arc::new)).collect::<Result<Vec<_>, _>>()?;
    let schema = Arc::new(Type::group_type_builder("table").with_fields(fields).build()?);
    // A fixed author keeps the bytes independent of the library's version string.
    let properties = Arc::new(WriterProperties::builder().set_created_by("sms".to_owned()).build());
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(&mut bytes, schema, properties)?;
    let mut group = file.next_row_group()?;
    for (_, column) in columns {
        let Some(mut writer) = group.next_column()? else {
            return Err(ParquetError::General("the schema has fewer columns than the table".to_owned()));
        };
        match column {
            Column::F64(v) => writer.typed::<DoubleType>().write_batch(v, None, None)?,
            Column::I32(v) => writer.typed::<Int32Type>().write_batch(v, None, None)?,
            Column::Text(v) => {
                let v: Vec<ByteArray> = v.iter().map(|s| ByteArray::from(s.as_str())).collect();
                writer.typed::<ByteArrayType>().write_batch(&v, None, None)?
            }
        };
        writer.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(bytes)
}

/// Reads a table that [`write_table`] wrote, with columns in their order.
///
/// # Errors
/// [`CoreError::Read`] when the file cannot be opened, [`CoreError::Input`] when it is another kind of file.
pub fn read_table(path: &Path) -> Result<Vec<(String, Column)>, CoreError> {
    let file = std::fs::File::open(path).map_err(CoreError::read(path))?;
    decode(file).map_err(|e| {
        InputError::new("this file is not a table of sms", path, "restore or regenerate the file")
            .because(e)
            .into()
    })
}

fn decode(file: std::fs::File) -> Result<Vec<(String, Column)>, ParquetError> {
    let reader = SerializedFileReader::new(file)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let mut columns: Vec<(String, Column)> = Vec::new();
    for g in 0..reader.num_row_groups() {
        let group = reader.get_row_group(g)?;
        let rows = group.metadata().num_rows() as usize;
        for c in 0..group.num_columns() {
            let part = match group.get_column_reader(c)? {
                ColumnReader::DoubleColumnReader(r) => Column::F64(values(r, rows)?),
                ColumnReader::Int32ColumnReader(r) => Column::I32(values(r, rows)?),
                ColumnReader::ByteArrayColumnReader(r) => {
                    let bytes = values(r, rows)?;
                    let text = bytes.iter().map(|b| b.as_utf8().map(str::to_owned));
                    Column::Text(text.collect::<Result<_, _>>()?)
                }
                _ => return Err(ParquetError::General(format!("column {c} has an unexpected type"))),
            };
            match (columns.get_mut(c), part) {
                (None, part) => columns.push((schema.column(c).name().to_owned(), part)),
                (Some((_, Column::F64(all))), Column::F64(v)) => all.extend(v),
                (Some((_, Column::I32(all))), Column::I32(v)) => all.extend(v),
                (Some((_, Column::Text(all))), Column::Text(v)) => all.extend(v),
                _ => return Err(ParquetError::General(format!("column {c} changes its type"))),
            }
        }
    }
    Ok(columns)
}

fn values<T: DataType>(mut column: ColumnReaderImpl<T>, rows: usize) -> Result<Vec<T::T>, ParquetError> {
    let mut values = Vec::with_capacity(rows);
    column.read_records(rows, None, None, &mut values)?;
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_reads_back_bit_for_bit_and_repeats_its_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let (path, again) = (dir.path().join("a.parquet"), dir.path().join("b.parquet"));
        let columns = [
            ("time_s", Column::F64(vec![0.0, -0.0, 1.0 / 3.0, 1e300, f64::MIN_POSITIVE])),
            ("index", Column::I32(vec![i32::MIN, -1, 0, 1, i32::MAX])),
            ("body", Column::Text(["a", "", "größe", "b", "a"].map(str::to_owned).to_vec())),
        ];
        write_table(&path, &columns).unwrap();
        write_table(&again, &columns).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&again).unwrap());
        let back = read_table(&path).unwrap();
        assert_eq!(back.len(), 3);
        for ((name, column), (name_back, column_back)) in columns.iter().zip(&back) {
            assert_eq!(name, name_back);
            assert_eq!(column, column_back);
        }
    }

    #[test]
    fn an_empty_table_keeps_its_columns() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("empty.parquet");
        write_table(&path, &[("x", Column::F64(vec![]))]).unwrap();
        assert_eq!(read_table(&path).unwrap(), vec![("x".to_owned(), Column::F64(vec![]))]);
    }

    #[test]
    fn unequal_columns_and_foreign_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bad.parquet");
        let unequal = [("a", Column::I32(vec![1])), ("b", Column::I32(vec![]))];
        assert!(matches!(write_table(&path, &unequal), Err(CoreError::Write { .. })));
        assert!(!path.exists());
        std::fs::write(&path, b"PAR1 is how it should begin and end").unwrap();
        assert!(matches!(read_table(&path), Err(CoreError::Input(_))));
    }
}
