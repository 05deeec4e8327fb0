//! Plots as SVG text: scales, axes, lines, bands, labels. Colours are CSS classes, so that one drawing serves light and
//! dark pages. Knows nothing of methods or metrics.

use crate::text::{compact, escape};
use std::fmt::Write as _;
use tauflow_data::{
    maths::{log10, pow},
    records::Estimate,
};

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
        if !self.log {
            return self.linear_ticks(count);
        }
        let ticks = self.log_ticks(count);
        // A short axis may lie between round powers and their doubles.
        let [low, high] = [self.low, self.high].map(|end| pow(10.0, end));
        if ticks.len() < 2 { Self { log: false, low, high }.linear_ticks(count) } else { ticks }
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

/// A plot of one panel. It is drawn when it is finished, so that its margins fit its texts. A wide plot is drawn twice:
/// a phone shows a narrow drawing with the same size of text, as texts of a scaled drawing could not be read.
pub struct Plot {
    size: [f64; 2],
    margins: Margins,
    x: Scale,
    y: Scale,
    title: String,
    subtitle: String,
    y_ticks: usize,
    x_ticks: Vec<(f64, String)>,
    x_title: String,
    marks: Vec<Mark>,
    labels: Vec<Label>,
}

/// A shape in data coordinates, with the class that says how it looks.
enum Mark {
    Line(Vec<(f64, f64)>, String),
    Dots(Vec<(f64, f64)>, f64, String),
    /// Points (x, low, high).
    Band(Vec<(f64, f64, f64)>, String),
    Level(f64, String),
}

struct Label {
    value: f64,
    class: String,
    text: String,
}

/// Least room around a panel: left, right, top, bottom. Long texts get more.
pub type Margins = [f64; 4];

/// Width of the drawing for phones.
const NARROW: f64 = 360.0;
/// Widths of a character in a wide font: of ticks, of labels in bold, of the title.
const TICK: f64 = 7.4;
const BOLD: f64 = 8.8;
const TITLE: f64 = 9.4;
/// Height of a line of the title.
const TITLE_LINE: f64 = 17.0;

/// A drawing of a given width.
struct Canvas<'a> {
    plot: &'a Plot,
    width: f64,
    height: f64,
    margins: Margins,
    body: String,
}

fn chars(text: &str) -> f64 {
    text.chars().count() as f64
}

/// Breaks a text at blanks into lines of at most `most` characters, where words allow.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut().filter(|line| line.chars().count() + 1 + word.chars().count() <= most) {
            Some(line) => *line += &format!(" {word}"),
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

impl Plot {
    /// An empty panel.
    pub fn new(size: [f64; 2], margins: Margins, x: Scale, y: Scale) -> Self {
        let (title, subtitle, x_title) = Default::default();
        let (x_ticks, marks, labels) = Default::default();
        Self { size, margins, x, y, title, subtitle, y_ticks: 0, x_ticks, x_title, marks, labels }
    }

    /// Horizontal grid lines with their values, about `count`.
    pub fn y_axis(&mut self, count: usize) -> &mut Self {
        self.y_ticks = count;
        self
    }

    /// Vertical ticks at these values, with their texts; texts without room are left out.
    pub fn x_axis(&mut self, ticks: impl IntoIterator<Item = (f64, String)>, title: &str) -> &mut Self {
        self.x_ticks = ticks.into_iter().collect();
        title.clone_into(&mut self.x_title);
        self
    }

    /// Round values on the x axis, about `count`.
    pub fn x_axis_round(&mut self, count: usize, title: &str) -> &mut Self {
        let ticks: Vec<(f64, String)> = self.x.ticks(count).into_iter().map(|v| (v, compact(v))).collect();
        self.x_axis(ticks, title)
    }

    /// The panel's title, above it, at the figure's left edge.
    pub fn title(&mut self, text: &str) -> &mut Self {
        text.clone_into(&mut self.title);
        self
    }

    /// A line below the title.
    pub fn subtitle(&mut self, text: &str) -> &mut Self {
        text.clone_into(&mut self.subtitle);
        self
    }

    /// A line through points in data coordinates; `class` says how it looks.
    pub fn line(&mut self, points: impl IntoIterator<Item = (f64, f64)>, class: &str) -> &mut Self {
        self.marks.push(Mark::Line(points.into_iter().collect(), class.to_owned()));
        self
    }

    /// Dots at points in data coordinates.
    pub fn dots(&mut self, points: impl IntoIterator<Item = (f64, f64)>, radius: f64, class: &str) -> &mut Self {
        self.marks.push(Mark::Dots(points.into_iter().collect(), radius, class.to_owned()));
        self
    }

    /// A band between a low and a high curve: points (x, low, high).
    pub fn band(&mut self, points: &[(f64, f64, f64)], class: &str) -> &mut Self {
        self.marks.push(Mark::Band(points.to_vec(), class.to_owned()));
        self
    }

    /// Means as a line with dots and its name at the right, and their intervals, if they have some, as a band.
    pub fn estimates(&mut self, points: &[(f64, Estimate)], has_intervals: bool, class: &str, name: &str) -> &mut Self {
        if has_intervals {
            let band: Vec<(f64, f64, f64)> = points.iter().map(|(x, e)| (*x, e.low, e.high)).collect();
            self.band(&band, class);
        }
        let line: Vec<(f64, f64)> = points.iter().map(|(x, e)| (*x, e.mean)).collect();
        self.line(line.clone(), class).dots(line.clone(), 3.4, class);
        if let Some((_, last)) = line.last() {
            self.end_label(*last, class, name);
        }
        self
    }

    /// A line over the whole width at a value.
    pub fn level(&mut self, y: f64, class: &str) -> &mut Self {
        self.marks.push(Mark::Level(y, class.to_owned()));
        self
    }

    /// A label at the right edge, beside the value; labels that would overlap are moved apart.
    pub fn end_label(&mut self, y: f64, class: &str, text: &str) -> &mut Self {
        self.labels.push(Label { value: y, class: class.to_owned(), text: text.to_owned() });
        self
    }

    /// The SVG, with a text for those who do not see it: two drawings of which the page shows one, unless it is small.
    pub fn finish(&self, description: &str) -> String {
        let [width, _] = self.size;
        if width <= NARROW {
            return self.draw(width, "plot", description);
        }
        let wide = if width > 600.0 { "plot large" } else { "plot wide" };
        let narrow = if width > 600.0 { "plot narrow under-large" } else { "plot narrow" };
        format!(
            "<div class=\"plots\">{}{}</div>",
            self.draw(width, wide, description),
            self.draw(NARROW, narrow, description)
        )
    }

    /// A drawing of this width.
    fn draw(&self, width: f64, class: &str, description: &str) -> String {
        let narrow = width < self.size[0];
        let [mut left, mut right, mut top, bottom] = self.margins;
        let mut height = if narrow { self.size[1].min(320.0) } else { self.size[1] };
        let ticks = self.y.ticks(self.y_ticks.max(1)).into_iter().map(compact);
        let ticks = ticks.map(|text| chars(&text) * TICK + 14.0).fold(0.0, f64::max);
        left = if self.y_ticks == 0 {
            left
        } else if narrow {
            ticks
        } else {
            left.max(ticks)
        };
        let labels = self.labels.iter().map(|label| chars(&label.text) * BOLD + 14.0).fold(0.0, f64::max);
        // Labels that would take more than half are broken into lines.
        right = if narrow { labels.clamp(12.0, 0.42 * width) } else { right.max(labels.min(0.4 * width)) };
        let title = wrapped(&self.title, (width / TITLE) as usize);
        let more = TITLE_LINE * title.len().saturating_sub(1) as f64;
        (top, height) = (top + more, height + more);
        let mut canvas = Canvas { plot: self, width, height, margins: [left, right, top, bottom], body: String::new() };
        canvas.texts(&title);
        canvas.axes();
        // Bands lie below all lines.
        let (bands, others): (Vec<&Mark>, Vec<&Mark>) =
            self.marks.iter().partition(|mark| matches!(mark, Mark::Band(..)));
        bands.into_iter().chain(others).for_each(|mark| canvas.mark(mark));
        canvas.labels();
        format!(
            r#"<svg class="{class}" viewBox="0 0 {:.0} {:.0}" role="img" aria-label="{}">{}</svg>"#,
            width,
            height,
            escape(description),
            canvas.body
        )
    }
}

impl Canvas<'_> {
    fn across(&self) -> f64 {
        self.width - self.margins[0] - self.margins[1]
    }

    fn down(&self) -> f64 {
        self.height - self.margins[2] - self.margins[3]
    }

    fn height_of(&self, place: f64) -> f64 {
        self.margins[2] + (1.0 - place) * self.down()
    }

    fn points(&self, points: impl IntoIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
        let at = |(x, y): (f64, f64)| {
            let (x, y) = (self.plot.x.place(x)?, self.plot.y.place(y)?);
            Some((self.margins[0] + x * self.across(), self.height_of(y)))
        };
        points.into_iter().filter_map(at).collect()
    }

    fn texts(&mut self, title: &[String]) {
        let mut y = 14.0;
        for line in title.iter().filter(|line| !line.is_empty()) {
            let _ = write!(self.body, r#"<text class="panel" x="0" y="{y:.0}">{}</text>"#, escape(line));
            y += TITLE_LINE;
        }
        if !self.plot.subtitle.is_empty() {
            let _ = write!(
                self.body,
                r#"<text class="tick" x="0" y="{:.0}">{}</text>"#,
                y + 1.0,
                escape(&self.plot.subtitle)
            );
        }
    }

    fn axes(&mut self) {
        let [left, right, _, bottom] = self.margins;
        let right = self.width - right;
        let ticks = if self.plot.y_ticks == 0 { Vec::new() } else { self.plot.y.ticks(self.plot.y_ticks) };
        for tick in ticks {
            // A line so near the axis would look like a double one.
            let Some(place) = self.plot.y.place(tick).filter(|p| *p > 0.02) else { continue };
            let y = self.height_of(place);
            let _ = write!(
                self.body,
                "<line class=\"grid\" x1=\"{left:.1}\" x2=\"{right:.1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                 <text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 8.0,
                y + 4.0,
                compact(tick)
            );
        }
        let base = self.height - bottom;
        let _ =
            write!(self.body, r#"<line class="axis" x1="{left:.1}" x2="{right:.1}" y1="{base:.1}" y2="{base:.1}"/>"#);
        let mut free = f64::NEG_INFINITY;
        for (value, text) in &self.plot.x_ticks {
            let Some(place) = self.plot.x.place(*value).filter(|p| (-0.001..=1.001).contains(p)) else { continue };
            let x = left + place * self.across();
            let _ = write!(
                self.body,
                r#"<line class="axis" x1="{x:.1}" x2="{x:.1}" y1="{base:.1}" y2="{:.1}"/>"#,
                base + 4.0
            );
            let half = chars(text) * TICK / 2.0;
            if x - half < free {
                continue;
            }
            free = x + half + 5.0;
            let _ = write!(
                self.body,
                r#"<text class="tick" x="{x:.1}" y="{:.1}" text-anchor="middle">{}</text>"#,
                base + 18.0,
                escape(text)
            );
        }
        if !self.plot.x_title.is_empty() {
            // In the middle of the axis, but inside the drawing.
            let half = (chars(&self.plot.x_title) * TICK / 2.0).min(self.width / 2.0);
            let _ = write!(
                self.body,
                r#"<text class="axis-title" x="{:.1}" y="{:.1}" text-anchor="middle">{}</text>"#,
                f64::midpoint(left, right).clamp(half, self.width - half),
                self.height - 4.0,
                escape(&self.plot.x_title)
            );
        }
    }

    fn mark(&mut self, mark: &Mark) {
        match mark {
            Mark::Line(points, class) => {
                let places = self.points(points.iter().copied());
                if places.len() > 1 {
                    let path = path_of(&places);
                    let _ = write!(self.body, r#"<path class="line {class}" d="{path}"/>"#);
                }
            }
            Mark::Dots(points, radius, class) => {
                for (x, y) in self.points(points.iter().copied()) {
                    let _ = write!(self.body, r#"<circle class="dot {class}" cx="{x:.1}" cy="{y:.1}" r="{radius}"/>"#);
                }
            }
            Mark::Band(points, class) => {
                let mut places = self.points(points.iter().map(|(x, low, _)| (*x, *low)));
                places.extend(self.points(points.iter().rev().map(|(x, _, high)| (*x, *high))));
                if places.len() > 3 {
                    let path = path_of(&places);
                    let _ = write!(self.body, r#"<path class="band {class}" d="{path}Z"/>"#);
                }
            }
            Mark::Level(value, class) => {
                if let Some(place) = self.plot.y.place(*value) {
                    let (y, left, right) = (self.height_of(place), self.margins[0], self.width - self.margins[1]);
                    let _ = write!(self.body, r#"<path class="line {class}" d="M{left:.1} {y:.1}H{right:.1}"/>"#);
                }
            }
        }
    }

    /// Labels at the right edge, each beside its value, moved apart where they would overlap.
    fn labels(&mut self) {
        const LINE: f64 = 15.0;
        let most = ((self.margins[1] - 8.0) / BOLD).max(1.0) as usize;
        let value = |label: &Label| self.plot.y.place(label.value).map(|place| self.height_of(place));
        let mut lines: Vec<(f64, &str, String)> = Vec::new();
        let mut labels: Vec<(f64, &Label)> =
            self.plot.labels.iter().filter_map(|label| Some((value(label)?, label))).collect();
        labels.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (y, label) in labels {
            lines.extend(wrapped(&label.text, most).into_iter().map(|line| (y, label.class.as_str(), line)));
        }
        let mut places: Vec<f64> = lines.iter().map(|line| line.0).collect();
        spread(&mut places, LINE, self.margins[2], self.height - self.margins[3]);
        let x = self.width - self.margins[1] + 8.0;
        for ((_, class, text), y) in lines.iter().zip(places) {
            let _ =
                write!(self.body, r#"<text class="end {class}" x="{x:.1}" y="{:.1}">{}</text>"#, y + 4.0, escape(text));
        }
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
        // Short axes have round values, too.
        for ends in [[0.105, 0.18], [0.023, 0.041], [1.02, 1.07], [700.0, 990.0]] {
            let ticks = Scale::log(ends, 0.0).ticks(5);
            assert!(ticks.len() >= 2 && ticks.iter().all(|v| (ends[0]..=ends[1]).contains(v)), "{ends:?}: {ticks:?}");
        }
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

    #[test]
    fn a_wide_plot_has_a_drawing_for_phones() {
        let mut plot = Plot::new([560.0, 300.0], [20.0; 4], Scale::linear([0.0, 1.0]), Scale::linear([0.0, 1.0]));
        let ticks = (0..=40).map(|i| (f64::from(i) / 40.0, format!("tick {i}")));
        plot.title("A title that has more words than a phone has room for").x_axis(ticks, "x");
        plot.line([(0.0, 0.0), (1.0, 1.0)], "c0").end_label(0.5, "c0", "a label of several words");
        let svg = plot.finish("x");
        let drawings: Vec<&str> = svg.split("<svg ").skip(1).collect();
        let [wide, narrow] = drawings[..] else { panic!("two drawings: {svg}") };
        assert!(wide.contains("viewBox=\"0 0 560 300\"") && narrow.contains("viewBox=\"0 0 360 "));
        assert_eq!((wide.matches("class=\"panel\"").count(), narrow.matches("class=\"panel\"").count()), (1, 2));
        // Texts of ticks that would overlap are left out; the ticks themselves are not.
        let ticks = |svg: &str| svg.matches(">tick ").count();
        assert!(ticks(wide) > ticks(narrow) && ticks(narrow) > 2, "{} {}", ticks(wide), ticks(narrow));
        assert_eq!(narrow.matches("class=\"axis\"").count(), 42);
    }

    #[test]
    fn texts_are_broken_at_blanks() {
        assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
        assert_eq!(wrapped("incomprehensible", 4), ["incomprehensible"]);
        assert_eq!(wrapped("", 4), [""]);
    }
}
