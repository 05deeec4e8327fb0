//! A score table as Parquet: the columns of the CSV files with types. Files are not compressed, and equal tables give
//! equal bytes.
//!
//! # Source
//! Apache Parquet, format version 2 (<https://parquet.apache.org/docs/file-format/>).

use super::{AxisType, AxisValue, Estimate, ScoreTable, TableAxis, TableCell};
use crate::records::computed;
use parquet::{
    basic::{LogicalType, Repetition, Type as Physical},
    data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{
        properties::WriterProperties,
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::types::Type,
};
use std::sync::Arc;
use tauflow_contract::KindError;

/// The values of a column, one for each row; none for a missing one.
enum Values {
    Integers(Vec<Option<i64>>),
    Numbers(Vec<Option<f64>>),
    Texts(Vec<Option<String>>),
}

/// A column and its name.
struct Column {
    name: String,
    values: Values,
}

impl Column {
    fn texts<'t>(name: &str, values: impl Iterator<Item = &'t str>) -> Self {
        Self { name: name.to_owned(), values: Values::Texts(values.map(|value| Some(value.to_owned())).collect()) }
    }

    fn numbers(name: &str, values: impl Iterator<Item = Option<f64>>) -> Self {
        Self { name: name.to_owned(), values: Values::Numbers(values.collect()) }
    }

    /// The coordinates on an axis. A cell without a coordinate there has an empty text, which does not count as one.
    fn axis<'t>(axis: &TableAxis, values: impl Iterator<Item = &'t AxisValue>) -> Self {
        let values: Vec<Option<&AxisValue>> =
            values.map(|value| Some(value).filter(|value| **value != AxisValue::Text(String::new()))).collect();
        let there = values.iter().flatten().map(|value| (*value).clone());
        let values = match TableAxis::new("", there).value_type {
            AxisType::Integer => {
                Values::Integers(values.into_iter().map(|value| value.and_then(AxisValue::integer)).collect())
            }
            AxisType::Number => {
                Values::Numbers(values.into_iter().map(|value| value.and_then(AxisValue::number)).collect())
            }
            AxisType::Text => Values::Texts(values.into_iter().map(|value| value.map(ToString::to_string)).collect()),
        };
        Self { name: axis.name.clone(), values }
    }

    /// The entry of the schema.
    fn field(&self) -> Result<Type, ParquetError> {
        let (physical, logical) = match self.values {
            Values::Integers(_) => (Physical::INT64, None),
            Values::Numbers(_) => (Physical::DOUBLE, None),
            Values::Texts(_) => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(&self.name, physical).with_repetition(Repetition::OPTIONAL);
        field.with_logical_type(logical).build()
    }

    fn write(self, group: &mut SerializedRowGroupWriter<'_, &mut Vec<u8>>) -> Result<(), ParquetError> {
        match self.values {
            Values::Integers(values) => write::<Int64Type>(group, values),
            Values::Numbers(values) => write::<DoubleType>(group, values),
            Values::Texts(values) => {
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
        return Err(ParquetError::General("the schema has fewer columns than the table".into()));
    };
    // Level 1 is a value, level 0 a null.
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let there: Vec<T::T> = values.into_iter().flatten().collect();
    column.typed::<T>().write_batch(&there, Some(&levels), None)?;
    column.close()
}

fn file(columns: Vec<Column>) -> Result<Vec<u8>, KindError> {
    let written = || -> Result<Vec<u8>, ParquetError> {
        let fields = columns.iter().map(|column| column.field().map(Arc::new)).collect::<Result<Vec<_>, _>>()?;
        let schema = Arc::new(Type::group_type_builder("table").with_fields(fields).build()?);
        let properties = Arc::new(WriterProperties::builder().set_created_by("tauflow".into()).build());
        let mut bytes = Vec::new();
        let mut writer = SerializedFileWriter::new(&mut bytes, schema, properties)?;
        let mut group = writer.next_row_group()?;
        columns.into_iter().try_for_each(|column| column.write(&mut group))?;
        group.close()?;
        writer.close()?;
        Ok(bytes)
    };
    written().map_err(|error| KindError::Internal(format!("the table cannot be written as Parquet: {error}")))
}

/// A number of an estimate; the ends of an interval only if there is one.
type Part = fn(&Estimate, bool) -> Option<f64>;

/// Means and intervals: one row for each cell and metric. Where there is no interval, its ends are null.
pub fn cells(table: &ScoreTable) -> Result<Vec<u8>, KindError> {
    let rows = || table.cells.iter().flat_map(|cell| table.metrics.iter().map(move |metric| (cell, metric)));
    let axes = table.axes.iter().enumerate();
    let mut columns: Vec<Column> =
        axes.map(|(place, axis)| Column::axis(axis, rows().map(|(cell, _)| &cell.at[place]))).collect();
    columns.push(Column::texts("metric", rows().map(|(_, metric)| metric.as_str())));
    let items = rows().map(|(cell, _)| i64::try_from(cell.items).ok()).collect();
    columns.push(Column { name: "items".into(), values: Values::Integers(items) });
    let parts: [(&str, Part); 3] = [
        ("mean", |e, _| Some(e.mean)),
        ("low", |e, there| there.then_some(e.low)),
        ("high", |e, there| there.then_some(e.high)),
    ];
    for (name, of) in parts {
        let own = |(cell, metric): (&TableCell, &String)| of(cell.metrics.get(metric)?, cell.has_intervals());
        columns.push(Column::numbers(name, rows().map(own)));
    }
    for (part, of) in parts {
        let name = if part == "mean" { "difference".to_owned() } else { format!("difference_{part}") };
        let own = |(cell, metric): (&TableCell, &String)| of(cell.difference.get(metric)?, cell.has_intervals());
        columns.push(Column::numbers(&name, rows().map(own)));
    }
    file(columns)
}

/// Every score: one row for each item and cell, one column for each metric. An infinite PSNR is an infinite number.
pub fn items(table: &ScoreTable) -> Result<Vec<u8>, KindError> {
    let rows = || table.per_item.iter();
    let mut columns = vec![Column::texts("item", rows().map(|row| row.item.as_str()))];
    if table.own_stratum() {
        columns.push(Column::texts("stratum", rows().map(|row| row.stratum.as_str())));
    }
    let axes = table.axes.iter().enumerate();
    columns.extend(axes.map(|(place, axis)| Column::axis(axis, rows().map(|row| &row.at[place]))));
    let metrics = computed(rows().map(|row| &row.metrics));
    columns.extend(metrics.iter().map(|name| Column::numbers(name, rows().map(|row| row.metrics.get(name)))));
    file(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::{
        file::{reader::FileReader, serialized_reader::SerializedFileReader},
        record::Field,
    };

    /// Names and types of the columns, and the rows.
    fn read(bytes: Vec<u8>) -> (Vec<String>, Vec<Vec<Field>>) {
        let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).expect("a Parquet file");
        let schema = reader.metadata().file_metadata().schema_descr();
        let columns = schema
            .columns()
            .iter()
            .map(|column| format!("{} {}", column.name(), column.physical_type().to_string().to_lowercase()));
        let row = |row: Result<parquet::record::Row, _>| {
            row.expect("a whole row").get_column_iter().map(|(_, field)| field.clone()).collect()
        };
        (columns.collect(), reader.get_row_iter(None).expect("rows").map(row).collect())
    }

    fn text(text: &str) -> Field {
        Field::Str(text.to_owned())
    }

    #[test]
    fn axes_are_typed_columns_and_absent_figures_are_null() {
        let table = super::super::tests::table();
        let bytes = cells(&table).expect("written");
        assert_eq!(bytes, cells(&table).expect("written"), "equal tables give equal bytes");
        let (columns, rows) = read(bytes);
        assert_eq!(columns[..4], ["sampler byte_array", "spp int64", "metric byte_array", "items int64"]);
        assert_eq!(
            columns[4..],
            ["mean", "low", "high", "difference", "difference_low", "difference_high"]
                .map(|name| format!("{name} double"))
        );
        let number = Field::Double;
        let first = [text("independent"), Field::Long(4), text("hdr_psnr"), Field::Long(2)];
        assert_eq!(rows[0][..4], first);
        assert_eq!(rows[0][4..], [number(20.0), number(19.0), number(21.0), Field::Null, Field::Null, Field::Null]);
        assert_eq!(rows[2][4..], [22.5, 21.5, 23.5, 2.5, 1.5, 3.5].map(number));
        assert_eq!(rows.len(), 3);
        let (columns, rows) = read(items(&table).expect("written"));
        assert_eq!(columns[..4], ["item byte_array", "stratum byte_array", "sampler byte_array", "spp int64"]);
        assert_eq!(
            rows[0][3..],
            [Field::Long(4), number(20.0), number(21.0), number(0.5), number(22.0), number(0.25), number(0.75)]
        );
    }

    #[test]
    fn a_cell_of_one_item_or_of_one_group_has_no_interval() {
        let mut table = super::super::tests::table();
        table.cells[0].items = 1;
        table.cells[2].one_group = true;
        let (_, rows) = read(cells(&table).expect("written"));
        let number = Field::Double;
        assert_eq!(rows[0][4..7], [number(20.0), Field::Null, Field::Null]);
        assert_eq!(rows[1][4..7], [26.0, 25.0, 27.0].map(number));
        assert_eq!(rows[2][4..], [number(22.5), Field::Null, Field::Null, number(2.5), Field::Null, Field::Null]);
    }

    #[test]
    fn an_axis_that_some_cells_lack_keeps_its_type() {
        let mut table = super::super::tests::table();
        table.cells[1].at[1] = AxisValue::parse("");
        table.cells[2].at[1] = AxisValue::parse("0.5");
        let (columns, rows) = read(cells(&table).expect("written"));
        assert_eq!(columns[1], "spp double");
        assert_eq!([&rows[0][1], &rows[1][1], &rows[2][1]], [&Field::Double(4.0), &Field::Null, &Field::Double(0.5)]);
    }

    #[test]
    fn a_stratum_that_is_an_axis_is_one_column() {
        let mut table = super::super::tests::table();
        table.axes[0].name = "stratum".into();
        let (columns, _) = read(items(&table).expect("written"));
        assert_eq!(columns[..2], ["item byte_array", "stratum byte_array"]);
        assert_eq!(columns.iter().filter(|name| name.starts_with("stratum")).count(), 1);
    }
}
