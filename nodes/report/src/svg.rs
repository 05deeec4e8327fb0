//! Plots as SVG text: scales, axes, lines, bands, labels. Colours are CSS classes, so that one drawing serves light and
//! dark pages. Knows nothing of methods or metrics.

use crate::text::{compact, escape};
use std::fmt::Write as _;
use tauflow_data::maths::{log10, pow};

/// How a value becomes a place on an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    log: bool,
    low: f64,
    high: f64,
}

impl Scale {
    /// A linear axis that holds `values` with a margin.
    pub fn linear(values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = range(values.into_iter().filter(|v| v.is_finite())).unwrap_or((0.0, 1.0));
        let span = if high > low { high - low } else { (high.abs() * 0.1).max(1e-6) };
        Self { log: false, low: low - 0.05 * span, high: high + 0.07 * span }
    }

    /// A logarithmic axis that holds the positive ones of `values`; `margin` is a share of its length.
    pub fn log(values: impl IntoIterator<Item = f64>, margin: f64) -> Self {
        let logs = values.into_iter().filter(|v| v.is_finite() && *v > 0.0).map(log10);
        let (low, high) = range(logs).unwrap_or((0.0, 1.0));
        let span = if high > low { high - low } else { 0.3 };
        Self { log: true, low: low - margin * span, high: high + margin * span }
    }

    /// The place of a value, 0 at the low end and 1 at the high end; none off a logarithmic axis.
    pub fn place(&self, value: f64) -> Option<f64> {
        let value = if self.log { if value > 0.0 { log10(value) } else { return None } } else { value };
        value.is_finite().then(|| (value - self.low) / (self.high - self.low))
    }

    /// About `count` round values on the axis.
    pub fn ticks(&self, count: usize) -> Vec<f64> {
        if self.log { self.log_ticks(count) } else { self.linear_ticks(count) }
    }

    fn linear_ticks(&self, count: usize) -> Vec<f64> {
        let raw = (self.high - self.low) / count.max(1) as f64;
        let decade = pow(10.0, log10(raw).floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|f| f * decade).find(|s| *s >= raw).unwrap_or(10.0 * decade);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }

    fn log_ticks(&self, count: usize) -> Vec<f64> {
        let (first, last) = (self.low.ceil() as i32, self.high.floor() as i32);
        let inside = |v: &f64| {
            let l = log10(*v);
            l >= self.low && l <= self.high
        };
        for factors in [&[1.0, 2.0, 5.0][..], &[1.0, 3.0], &[1.0]] {
            let ticks: Vec<f64> = (first - 1..=last + 1)
                .flat_map(|e| factors.iter().map(move |f| f * pow(10.0, f64::from(e))))
                .filter(inside)
                .collect();
            if ticks.len() <= count.max(2) || factors.len() == 1 {
                let stride = ticks.len().div_ceil(count.max(2)).max(1);
                return ticks.into_iter().step_by(stride).collect();
            }
        }
        Vec::new()
    }
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |seen, v| {
        let (low, high) = seen.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    })
}

/// A plot of one panel.
pub struct Plot {
    width: f64,
    height: f64,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: Scale,
    y: Scale,
    body: String,
    labels: Vec<Label>,
}

struct Label {
    y: f64,
    class: String,
    text: String,
}

/// Room around a panel: left, right, top, bottom.
pub type Margins = [f64; 4];

impl Plot {
    /// An empty panel.
    pub fn new(size: [f64; 2], margins: Margins, x: Scale, y: Scale) -> Self {
        let [width, height] = size;
        let [left, right, top, bottom] = margins;
        Self { width, height, left, right, top, bottom, x, y, body: String::new(), labels: Vec::new() }
    }

    fn at(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let across = self.width - self.left - self.right;
        let down = self.height - self.top - self.bottom;
        Some((self.left + self.x.place(x)? * across, self.top + (1.0 - self.y.place(y)?) * down))
    }

    fn points(&self, points: impl IntoIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
        points.into_iter().filter_map(|(x, y)| self.at(x, y)).collect()
    }

    /// Horizontal grid lines with their values, about `count`.
    pub fn y_axis(&mut self, count: usize) -> &mut Self {
        for tick in self.y.ticks(count) {
            // A line so near the axis would look like a double one.
            let Some(place) = self.y.place(tick).filter(|p| *p > 0.02) else { continue };
            let y = self.top + (1.0 - place) * (self.height - self.top - self.bottom);
            let (left, right) = (self.left, self.width - self.right);
            let _ = write!(
                self.body,
                "<line class=\"grid\" x1=\"{left:.1}\" x2=\"{right:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                 <text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 8.0,
                y + 4.0,
                compact(tick)
            );
        }
        self
    }

    /// Vertical ticks at these values, with their texts.
    pub fn x_axis(&mut self, ticks: impl IntoIterator<Item = (f64, String)>, title: &str) -> &mut Self {
        let base = self.height - self.bottom;
        let (left, right) = (self.left, self.width - self.right);
        let _ =
            write!(self.body, r#"<line class="axis" x1="{left:.1}" x2="{right:.1}" y1="{base:.1}" y2="{base:.1}"/>"#);
        for (value, text) in ticks {
            let Some(place) = self.x.place(value).filter(|p| (-0.001..=1.001).contains(p)) else { continue };
            let x = left + place * (right - left);
            let _ = write!(
                self.body,
                "<line class=\"axis\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{base:.1}\" y2=\"{:.1}\"/>\
                 <text class=\"tick\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                base + 4.0,
                base + 18.0,
                escape(&text)
            );
        }
        let _ = write!(
            self.body,
            r#"<text class="axis-title" x="{:.1}" y="{:.1}" text-anchor="middle">{}</text>"#,
            (left + right) / 2.0,
            self.height - 4.0,
            escape(title)
        );
        self
    }

    /// Round values on the x axis, about `count`.
    pub fn x_axis_round(&mut self, count: usize, title: &str) -> &mut Self {
        let ticks: Vec<(f64, String)> = self.x.ticks(count).into_iter().map(|v| (v, compact(v))).collect();
        self.x_axis(ticks, title)
    }

    /// The panel's title, above it, at the figure's left edge.
    pub fn title(&mut self, text: &str) -> &mut Self {
        let _ = write!(self.body, r#"<text class="panel" x="0" y="14">{}</text>"#, escape(text));
        self
    }

    /// A line below the title.
    pub fn subtitle(&mut self, text: &str) -> &mut Self {
        let _ = write!(self.body, r#"<text class="tick" x="0" y="32">{}</text>"#, escape(text));
        self
    }

    /// A line through points in data coordinates; `class` says how it looks.
    pub fn line(&mut self, points: impl IntoIterator<Item = (f64, f64)>, class: &str) -> &mut Self {
        let places = self.points(points);
        if places.len() > 1 {
            let path = path_of(&places);
            let _ = write!(self.body, r#"<path class="line {class}" d="{path}"/>"#);
        }
        self
    }

    /// Dots at points in data coordinates.
    pub fn dots(&mut self, points: impl IntoIterator<Item = (f64, f64)>, radius: f64, class: &str) -> &mut Self {
        for (x, y) in self.points(points) {
            let _ = write!(self.body, r#"<circle class="dot {class}" cx="{x:.1}" cy="{y:.1}" r="{radius}"/>"#);
        }
        self
    }

    /// A band between a low and a high curve: points (x, low, high).
    pub fn band(&mut self, points: &[(f64, f64, f64)], class: &str) -> &mut Self {
        let mut places = self.points(points.iter().map(|(x, low, _)| (*x, *low)));
        places.extend(self.points(points.iter().rev().map(|(x, _, high)| (*x, *high))));
        if places.len() > 3 {
            let path = path_of(&places);
            let _ = write!(self.body, r#"<path class="band {class}" d="{path}Z"/>"#);
        }
        self
    }

    /// A line over the whole width at a value.
    pub fn level(&mut self, y: f64, class: &str) -> &mut Self {
        if let Some(place) = self.y.place(y) {
            let y = self.top + (1.0 - place) * (self.height - self.top - self.bottom);
            let (left, right) = (self.left, self.width - self.right);
            let _ = write!(self.body, r#"<path class="line {class}" d="M{left:.1} {y:.1}H{right:.1}"/>"#);
        }
        self
    }

    /// A label at the right edge, beside the value; labels that would overlap are moved apart.
    pub fn end_label(&mut self, y: f64, class: &str, text: &str) -> &mut Self {
        if let Some(place) = self.y.place(y) {
            let y = self.top + (1.0 - place) * (self.height - self.top - self.bottom);
            self.labels.push(Label { y, class: class.to_owned(), text: escape(text) });
        }
        self
    }

    /// The SVG, with a text for those who do not see it.
    pub fn finish(mut self, description: &str) -> String {
        const LINE: f64 = 15.0;
        self.labels.sort_by(|a, b| a.y.total_cmp(&b.y));
        let mut places: Vec<f64> = self.labels.iter().map(|l| l.y).collect();
        spread(&mut places, LINE, self.top, self.height - self.bottom);
        let x = self.width - self.right + 8.0;
        for (label, y) in self.labels.iter().zip(places) {
            let _ = write!(
                self.body,
                r#"<text class="end {}" x="{x:.1}" y="{:.1}">{}</text>"#,
                label.class,
                y + 4.0,
                label.text
            );
        }
        format!(
            r#"<svg class="plot" viewBox="0 0 {:.0} {:.0}" role="img" aria-label="{}">{}</svg>"#,
            self.width,
            self.height,
            escape(description),
            self.body
        )
    }
}

fn path_of(places: &[(f64, f64)]) -> String {
    let mut path = String::new();
    for (i, (x, y)) in places.iter().enumerate() {
        let _ = write!(path, "{}{x:.1} {y:.1}", if i == 0 { 'M' } else { 'L' });
    }
    path
}

/// Moves sorted places apart to at least `gap`, keeping them between `low` and `high` where they fit.
pub fn spread(places: &mut [f64], gap: f64, low: f64, high: f64) {
    for i in 1..places.len() {
        places[i] = places[i].max(places[i - 1] + gap);
    }
    let over = places.last().map_or(0.0, |last| (last - high).max(0.0));
    if over > 0.0 {
        if let Some(last) = places.last_mut() {
            *last -= over;
        }
        for i in (1..places.len()).rev() {
            places[i - 1] = places[i - 1].min(places[i] - gap);
        }
    }
    if places.first().is_some_and(|first| *first < low) {
        let under = low - places[0];
        places[0] += under;
        for i in 1..places.len() {
            places[i] = places[i].max(places[i - 1] + gap);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let scale = Scale::linear([12.3, 27.9]);
        assert_eq!(scale.ticks(4), [15.0, 20.0, 25.0]);
        let log = Scale::log([1.0, 256.0], 0.0);
        let ticks: Vec<String> = log.ticks(9).into_iter().map(compact).collect();
        assert_eq!(ticks, ["1", "2", "5", "10", "20", "50", "100", "200"]);
        assert!(log.place(0.0).is_none() && log.place(-1.0).is_none());
        assert_eq!(log.place(1.0), Some(0.0));
    }

    #[test]
    fn a_flat_or_empty_series_still_has_an_axis() {
        for scale in [Scale::linear([3.0, 3.0]), Scale::linear([]), Scale::log([5.0], 0.1), Scale::log([], 0.0)] {
            assert!(!scale.ticks(4).is_empty());
        }
        let place = Scale::linear([3.0]).place(3.0).expect("finite");
        assert!((0.0..=1.0).contains(&place));
    }

    #[test]
    fn labels_do_not_overlap() {
        let mut places = [10.0, 11.0, 12.0, 99.0];
        spread(&mut places, 15.0, 0.0, 100.0);
        assert!(places.windows(2).all(|w| w[1] - w[0] >= 15.0 - 1e-9), "{places:?}");
        let mut low = [98.0, 99.0, 100.0];
        spread(&mut low, 15.0, 0.0, 100.0);
        assert!(low[2] <= 100.0 && low.windows(2).all(|w| w[1] - w[0] >= 15.0 - 1e-9));
    }

    #[test]
    fn infinite_points_are_left_out() {
        let mut plot = Plot::new([200.0, 100.0], [20.0; 4], Scale::linear([0.0, 1.0]), Scale::linear([0.0, 1.0]));
        plot.line([(0.0, 0.0), (0.5, f64::INFINITY), (1.0, 1.0)], "c0").end_label(0.5, "c0", "<b>");
        let svg = plot.finish("x");
        assert!(!svg.contains("inf") && !svg.contains("NaN") && svg.contains("&lt;b&gt;"));
    }
}
