//! Tables of scores by any axes, as `table` hands them on: for the report, and as CSV, LaTeX and Parquet files.

mod csv;
mod parquet;
mod tex;

use super::{Estimate, Metrics, has_intervals};
use serde::{Deserialize, Serialize};
use std::{cmp::Ordering, collections::BTreeMap, fmt};
use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json};

/// The part that holds the whole table.
const WHOLE: &str = "table.json";

/// A value on an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum AxisValue {
    /// A whole number, such as a sample count.
    Integer(i64),
    /// Any other finite number.
    Number(f64),
    /// A text, such as the name of a sampler. Empty where a cell has no such coordinate.
    Text(String),
}

impl AxisValue {
    /// Reads a coordinate: a whole number, else a finite number, else a text.
    pub fn parse(text: &str) -> Self {
        if let Ok(value) = text.parse::<i64>() {
            return Self::Integer(value);
        }
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Self::Number(value),
            _ => Self::Text(text.to_owned()),
        }
    }

    /// The value as a number, for plots; none for a text.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Integer(value) => Some(*value as f64),
            Self::Number(value) => Some(*value),
            Self::Text(_) => None,
        }
    }

    /// The value as a whole number; none for any other.
    pub fn integer(&self) -> Option<i64> {
        match self {
            Self::Integer(value) => Some(*value),
            Self::Number(_) | Self::Text(_) => None,
        }
    }

    /// Numbers by size, then texts by name: the order of rows and columns.
    pub fn order(&self, other: &Self) -> Ordering {
        match (self.number(), other.number()) {
            (Some(a), Some(b)) => a.total_cmp(&b),
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (None, None) => self.to_string().cmp(&other.to_string()),
        }
    }
}

impl fmt::Display for AxisValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(value) => value.fmt(f),
            Self::Number(value) => value.fmt(f),
            Self::Text(value) => value.fmt(f),
        }
    }
}

/// The type of an axis: that of all its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisType {
    /// Whole numbers.
    Integer,
    /// Numbers.
    Number,
    /// Texts.
    Text,
}

/// An axis of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableAxis {
    /// Its name, e.g. `sampler` or `spp`.
    pub name: String,
    /// The type of all its values.
    #[serde(rename = "type")]
    pub value_type: AxisType,
    /// Its values in order, each once.
    pub values: Vec<AxisValue>,
}

impl TableAxis {
    /// The axis of these values. One text makes all of them texts, one fraction makes all of them numbers.
    pub fn new(name: impl Into<String>, values: impl IntoIterator<Item = AxisValue>) -> Self {
        let mut values: Vec<AxisValue> = values.into_iter().collect();
        let value_type = if values.iter().any(|value| matches!(value, AxisValue::Text(_))) {
            AxisType::Text
        } else if values.iter().any(|value| matches!(value, AxisValue::Number(_))) {
            AxisType::Number
        } else {
            AxisType::Integer
        };
        values.sort_by(AxisValue::order);
        values.dedup();
        Self { name: name.into(), value_type, values }
    }
}

/// A cell of the table: one combination of values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableCell {
    /// Its value on each axis, in the order of the axes.
    pub at: Vec<AxisValue>,
    /// Number of items that its means are over.
    pub items: u64,
    /// Whether groups are known and all these items are of one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub one_group: bool,
    /// Means with their intervals, by metric.
    pub metrics: BTreeMap<String, Estimate>,
    /// Difference to the cell that the table compares with, paired by item; empty without one, and in that cell.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub difference: BTreeMap<String, Estimate>,
}

impl TableCell {
    /// Whether its means and differences have intervals.
    pub fn has_intervals(&self) -> bool {
        has_intervals(self.items, self.one_group.then_some(1))
    }
}

/// One score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableItem {
    /// The item's key, without its cell.
    pub item: String,
    /// Its stratum, `other` if the key names none.
    pub stratum: String,
    /// Its value on each axis, in the order of the axes.
    pub at: Vec<AxisValue>,
    /// Its metrics.
    pub metrics: Metrics,
}

/// The cell that others are compared with: the one with this value on an axis and the same values on all others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableAgainst {
    /// Name of the axis.
    pub axis: String,
    /// The value there.
    pub value: AxisValue,
}

/// Which files go along with the JSON and CSV files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TableFormats {
    /// `table.tex`, for the package booktabs.
    pub latex: bool,
    /// `table.parquet` and `items.parquet`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub parquet: bool,
}

/// Means of metrics by axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreTable {
    /// What the table is called.
    pub title: String,
    /// The axes: those of rows first, then those of columns.
    pub axes: Vec<TableAxis>,
    /// How many of the axes make rows; the others make columns.
    pub row_axes: usize,
    /// Names of the metrics, in order.
    pub metrics: Vec<String>,
    /// Sample count of the references; none if references differ in it.
    pub reference_spp: Option<u64>,
    /// Number of items.
    pub items: u64,
    /// Number of groups of items that intervals are over; none where each item stands for itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub groups: Option<u64>,
    /// Number of bootstrap resamples.
    pub resamples: u64,
    /// The cells that differences are to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub against: Option<TableAgainst>,
    /// The cells, in the order of their values.
    pub cells: Vec<TableCell>,
    /// Every score.
    pub per_item: Vec<TableItem>,
    /// Methods without a score, and why.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Which files are written.
    pub formats: TableFormats,
}

impl ScoreTable {
    /// The axes of rows, and those of columns.
    pub fn split_axes(&self) -> (&[TableAxis], &[TableAxis]) {
        self.axes.split_at(self.row_axes.min(self.axes.len()))
    }

    /// Whether strata need a column of their own in files: they are no axis.
    fn own_stratum(&self) -> bool {
        self.axes.iter().all(|axis| axis.name != "stratum")
    }

    /// The cell with these values.
    pub fn cell(&self, at: &[AxisValue]) -> Option<&TableCell> {
        self.cells.iter().find(|cell| cell.at == at)
    }

    /// The distinct values of the first `row_axes` axes, or of the others, as cells have them in order.
    fn heads(&self, of_rows: bool) -> Vec<Vec<AxisValue>> {
        let part = |cell: &TableCell| {
            let (rows, columns) = cell.at.split_at(self.row_axes.min(cell.at.len()));
            if of_rows { rows.to_vec() } else { columns.to_vec() }
        };
        let mut heads: Vec<Vec<AxisValue>> = self.cells.iter().map(part).collect();
        heads.sort_by(|a, b| order(a, b));
        heads.dedup();
        heads
    }

    /// The values of each row on the axes of rows, in order.
    pub fn row_heads(&self) -> Vec<Vec<AxisValue>> {
        self.heads(true)
    }

    /// The values of each column on the axes of columns, in order; one without values if no axis makes columns.
    pub fn column_heads(&self) -> Vec<Vec<AxisValue>> {
        self.heads(false)
    }

    /// The files, by name, as `export` writes them.
    ///
    /// # Errors
    /// If a number cannot be written as JSON, or a column not as Parquet.
    pub fn files(&self) -> Result<Vec<(&'static str, Vec<u8>)>, KindError> {
        let mut files = vec![
            (WHOLE, pretty_json(self)?),
            ("table.csv", csv::cells(self).into_bytes()),
            ("items.csv", csv::items(self).into_bytes()),
        ];
        if self.formats.latex {
            files.push(("table.tex", tex::tables(self).into_bytes()));
        }
        if self.formats.parquet {
            files.push(("table.parquet", parquet::cells(self)?));
            files.push(("items.parquet", parquet::items(self)?));
        }
        Ok(files)
    }
}

/// The order of rows and columns.
pub fn order(a: &[AxisValue], b: &[AxisValue]) -> Ordering {
    a.iter().zip(b).map(|(a, b)| a.order(b)).find(|by| by.is_ne()).unwrap_or_else(|| a.len().cmp(&b.len()))
}

impl Media for ScoreTable {
    const NAME: &'static str = "tauflow/score-table";
    const DOC: &'static str =
        "Means by axes: `table.json`, `table.csv`, `items.csv`, and LaTeX and Parquet if asked for.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        ctx.json(artifact, WHOLE)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let part = |(name, bytes): (&str, Vec<u8>)| Ok((name.to_owned(), ctx.put(&bytes)?));
        Ok(Stored::tree(self.files()?.into_iter().map(part).collect::<Result<Vec<_>, KindError>>()?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        Self::load(ctx, artifact)?.files()?.into_iter().try_for_each(|(name, bytes)| to.put(name, &bytes))
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let table = parse_json::<Self>(WHOLE, &from.need(WHOLE)?)?;
        for (name, bytes) in table.files()? {
            if from.need(name)? != bytes {
                return Err(KindError::Input(format!(
                    "`{name}` differs from what `{WHOLE}` says; export the table again, or change both files alike"
                )));
            }
        }
        table.store(ctx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{FileTree, MemoryBlobs, Silent};

    /// Two samplers at two sample counts, of which one was not measured.
    pub(super) fn table() -> ScoreTable {
        let text = |value: &str| AxisValue::Text(value.into());
        let estimate = |mean: f64| Estimate { mean, low: mean - 1.0, high: mean + 1.0 };
        let cell = |sampler: &str, spp: i64, mean: f64, gain: Option<f64>| TableCell {
            at: vec![text(sampler), AxisValue::Integer(spp)],
            items: 2,
            one_group: false,
            metrics: BTreeMap::from([("hdr_psnr".to_owned(), estimate(mean))]),
            difference: gain.map(|gain| ("hdr_psnr".to_owned(), estimate(gain))).into_iter().collect(),
        };
        let metrics = Metrics {
            hdr_psnr: 20.0,
            hdr_psnr_max: 21.0,
            hdr_mae: 0.5,
            preview_psnr: 22.0,
            preview_mae: 0.25,
            ssim: 0.75,
            ..Metrics::default()
        };
        ScoreTable {
            title: "Two, samplers".into(),
            axes: vec![
                TableAxis::new("sampler", [text("sobol"), text("independent")]),
                TableAxis::new("spp", [AxisValue::Integer(16), AxisValue::Integer(4)]),
            ],
            row_axes: 1,
            metrics: vec!["hdr_psnr".into()],
            reference_spp: Some(1024),
            items: 2,
            groups: None,
            resamples: 100,
            against: Some(TableAgainst { axis: "sampler".into(), value: text("independent") }),
            cells: vec![
                cell("independent", 4, 20.0, None),
                cell("independent", 16, 26.0, None),
                cell("sobol", 4, 22.5, Some(2.5)),
            ],
            per_item: vec![TableItem {
                item: "L0-open-000001".into(),
                stratum: "L0-open".into(),
                at: vec![text("sobol"), AxisValue::Integer(4)],
                metrics,
            }],
            notes: Vec::new(),
            formats: TableFormats { latex: true, parquet: true },
        }
    }

    #[test]
    fn coordinates_have_types_and_an_order() {
        assert_eq!(AxisValue::parse("16"), AxisValue::Integer(16));
        assert_eq!(AxisValue::parse("0.5"), AxisValue::Number(0.5));
        assert_eq!(AxisValue::parse("inf"), AxisValue::Text("inf".into()));
        let axis = TableAxis::new("spp", ["16", "4", "4", "0.5"].map(AxisValue::parse));
        assert_eq!(axis.value_type, AxisType::Number);
        assert_eq!(axis.values, ["0.5", "4", "16"].map(AxisValue::parse));
        assert_eq!(TableAxis::new("a", ["4", "x"].map(AxisValue::parse)).value_type, AxisType::Text);
    }

    #[test]
    fn rows_and_columns_are_those_that_cells_have() {
        let table = table();
        assert_eq!(table.row_heads(), [[AxisValue::parse("independent")], [AxisValue::parse("sobol")]]);
        assert_eq!(table.column_heads(), [[AxisValue::Integer(4)], [AxisValue::Integer(16)]]);
        assert!(table.cell(&[AxisValue::parse("sobol"), AxisValue::Integer(16)]).is_none());
    }

    #[test]
    fn a_table_comes_back_from_the_files_that_export_wrote() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let stored = table().store(&ctx).expect("in memory");
        assert_eq!(stored.handle().load(&ctx).expect("whole"), table());
        let mut files = FileTree::new();
        ScoreTable::export(&ctx, stored.artifact(), &mut files).expect("whole");
        assert_eq!(
            files.keys().collect::<Vec<_>>(),
            ["items.csv", "items.parquet", "table.csv", "table.json", "table.parquet", "table.tex"]
        );
        assert_eq!(ScoreTable::import(&ctx, &files).expect("own files").artifact(), stored.artifact());
    }
}
