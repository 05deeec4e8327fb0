//! Rows of an export as Parquet: one column for every name, with the type that all its values have. Files are not
//! compressed, and equal rows give equal bytes.
//!
//! # Source
//! Apache Parquet, format version 2 (<https://parquet.apache.org/docs/file-format/>).

use parquet::{
    basic::{LogicalType, Repetition, Type as Physical},
    data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::types::Type,
};
use serde_json::{Map, Value};
use std::sync::Arc;
use tauflow_contract::KindError;

/// The values of a column, one for each row; none for a missing one.
#[derive(Debug, PartialEq)]
enum Column {
    Truths(Vec<Option<bool>>),
    Integers(Vec<Option<i64>>),
    Numbers(Vec<Option<f64>>),
    Texts(Vec<Option<String>>),
}

impl Column {
    /// The narrowest type that holds all values.
    fn of(values: &[Option<&Value>]) -> Self {
        let values: Vec<Option<&Value>> = values.iter().map(|value| value.filter(|value| !value.is_null())).collect();
        let all = |fits: fn(&Value) -> bool| values.iter().flatten().all(|value| fits(value));
        if all(Value::is_boolean) && values.iter().any(Option::is_some) {
            return Self::Truths(values.iter().map(|value| value.and_then(Value::as_bool)).collect());
        }
        if all(|value| value.as_i64().is_some()) {
            return Self::Integers(values.iter().map(|value| value.and_then(Value::as_i64)).collect());
        }
        if all(Value::is_number) {
            return Self::Numbers(values.iter().map(|value| value.and_then(Value::as_f64)).collect());
        }
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        Self::Texts(values.iter().map(|value| value.map(text)).collect())
    }

    fn field(&self, name: &str) -> Result<Type, ParquetError> {
        let (physical, logical) = match self {
            Self::Truths(_) => (Physical::BOOLEAN, None),
            Self::Integers(_) => (Physical::INT64, None),
            Self::Numbers(_) => (Physical::DOUBLE, None),
            Self::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(name, physical).with_repetition(Repetition::OPTIONAL);
        field.with_logical_type(logical).build()
    }

    fn write(self, group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>) -> Result<(), ParquetError> {
        match self {
            Self::Truths(values) => write::<BoolType>(group, values),
            Self::Integers(values) => write::<Int64Type>(group, values),
            Self::Numbers(values) => write::<DoubleType>(group, values),
            Self::Texts(values) => {
                let bytes = values.into_iter().map(|value| value.map(|text| ByteArray::from(text.into_bytes())));
                write::<ByteArrayType>(group, bytes.collect())
            }
        }
    }
}

/// Writes the next column of a row group.
fn write<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>,
    values: Vec<Option<T::T>>,
) -> Result<(), ParquetError> {
    let Some(mut column) = group.next_column()? else {
        return Err(ParquetError::General("the schema has fewer columns than the rows".into()));
    };
    // Level 1 is a value, level 0 a null.
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let there: Vec<T::T> = values.into_iter().flatten().collect();
    column.typed::<T>().write_batch(&there, Some(&levels), None)?;
    column.close()
}

/// The rows as a file, with columns in this order.
pub(super) fn file(names: &[&String], rows: &[Map<String, Value>]) -> Result<Vec<u8>, KindError> {
    let column = |name: &&String| Column::of(&rows.iter().map(|row| row.get(*name)).collect::<Vec<_>>());
    let columns: Vec<Column> = names.iter().map(column).collect();
    let written = || -> Result<Vec<u8>, ParquetError> {
        let fields = names.iter().zip(&columns).map(|(name, column)| column.field(name).map(Arc::new));
        let fields = fields.collect::<Result<Vec<_>, _>>()?;
        let schema = Arc::new(Type::group_type_builder("rows").with_fields(fields).build()?);
        let properties = Arc::new(WriterProperties::builder().set_created_by("tauflow".into()).build());
        let mut bytes = Vec::new();
        let mut writer = SerializedFileWriter::new(&mut bytes, schema, properties)?;
        let mut group = writer.next_row_group()?;
        columns.into_iter().try_for_each(|column| column.write(&mut group))?;
        group.close()?;
        writer.close()?;
        Ok(bytes)
    };
    written().map_err(|error| KindError::Internal(format!("the rows cannot be written as Parquet: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_column_has_the_type_of_all_its_values() {
        let column = |values: &[Value]| Column::of(&values.iter().map(Some).collect::<Vec<_>>());
        assert_eq!(column(&[json!(1), json!(null)]), Column::Integers(vec![Some(1), None]));
        assert_eq!(column(&[json!(1), json!(0.5)]), Column::Numbers(vec![Some(1.0), Some(0.5)]));
        assert_eq!(column(&[json!(true), json!(false)]), Column::Truths(vec![Some(true), Some(false)]));
        let texts = Column::Texts(vec![Some("a".into()), Some("1".into())]);
        assert_eq!(column(&[json!("a"), json!(1)]), texts);
        assert_eq!(Column::of(&[None, Some(&json!("x"))]), Column::Texts(vec![None, Some("x".into())]));
    }

    #[test]
    fn a_file_reads_back() {
        use parquet::{
            file::{reader::FileReader, serialized_reader::SerializedFileReader},
            record::Field,
        };
        let row = |text: Value| text.as_object().expect("an object").clone();
        let rows = [row(json!({ "item": "a", "psnr": 20.5 })), row(json!({ "item": "b", "nfe": 2 }))];
        let names = ["item", "nfe", "psnr"].map(str::to_owned);
        let bytes = file(&names.iter().collect::<Vec<_>>(), &rows).expect("written");
        let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).expect("a Parquet file");
        let rows = reader.get_row_iter(None).expect("rows").map(|row| row.expect("a whole row"));
        let rows: Vec<Vec<Field>> =
            rows.map(|row| row.get_column_iter().map(|(_, field)| field.clone()).collect()).collect();
        let text = |text: &str| Field::Str(text.to_owned());
        assert_eq!(rows[0], [text("a"), Field::Null, Field::Double(20.5)]);
        assert_eq!(rows[1], [text("b"), Field::Long(2), Field::Null]);
    }
}
