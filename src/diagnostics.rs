//! Problems of a pipeline: message, place and remedy. The only module that renders them.
//!
//! All problems of a file are shown together.

use miette::{
    GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteError, NamedSource, SourceCode, SourceSpan, SpanContents,
};
use std::{fmt, sync::Arc};
use strsim::osa_distance;

/// Some bytes of a source.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Span {
    /// Which source, an index into [`Sources`].
    pub source: usize,
    /// First byte.
    pub start: usize,
    /// Number of bytes.
    pub len: usize,
}

/// The texts that problems point into: pipeline files, and the command line's overrides.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    texts: Vec<Arc<NamedSource<String>>>,
}

impl Sources {
    /// Adds a text, and gives its index.
    pub fn add(&mut self, name: impl Into<String>, text: impl Into<String>) -> usize {
        self.texts.push(Arc::new(NamedSource::new(name.into(), text.into())));
        self.texts.len() - 1
    }

    /// A text.
    pub fn text(&self, source: usize) -> &str {
        self.texts[source].inner()
    }

    /// `file:line:column` of a span, counted from 1.
    pub fn place(&self, span: Span) -> String {
        let text = self.text(span.source);
        let before = &text[..span.start.min(text.len())];
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
        format!("{}:{line}:{column}", self.texts[span.source].name())
    }
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// The problem.
    pub message: String,
    /// Where; none for problems with the command line.
    pub span: Option<Span>,
    /// The remedy.
    pub hint: Hint,
    /// The named value that stands there, if one does.
    pub value: Option<NamedValue>,
}

/// The remedy for a problem. It is put into words when it is shown: of twenty thousand problems few are.
#[derive(Clone, Debug, PartialEq)]
pub enum Hint {
    /// Nothing can be said.
    None,
    /// As it is.
    Text(String),
    /// The nearest of some names, or else all of them.
    Near {
        /// The text as written.
        wanted: String,
        /// The type of the names, such as `nodes`.
        what: &'static str,
        /// The names.
        names: Arc<[String]>,
    },
}

impl From<String> for Hint {
    fn from(text: String) -> Self {
        if text.is_empty() { Self::None } else { Self::Text(text) }
    }
}

impl From<&str> for Hint {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl Hint {
    /// Names the nearest of `names` to what was written, or else all of them.
    pub fn near(wanted: &str, what: &'static str, names: &Arc<[String]>) -> Self {
        Self::Near { wanted: wanted.to_owned(), what, names: names.clone() }
    }

    /// In words.
    pub fn text(&self) -> Option<String> {
        match self {
            Self::None => None,
            Self::Text(text) => Some(text.clone()),
            Self::Near { wanted, what, names } => Some(did_you_mean(wanted, what, names.iter().map(String::as_str))),
        }
    }
}

/// A named value that stands where a problem is.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedValue {
    /// `$name`, and the value if it is short.
    pub text: String,
    /// Where it is set.
    pub set: Span,
}

impl Problem {
    /// A problem at a place.
    pub fn at(span: Span, message: impl Into<String>) -> Self {
        Self { span: Some(span), ..Self::nowhere(message) }
    }

    /// A problem that has no place in a file.
    pub fn nowhere(message: impl Into<String>) -> Self {
        Self { message: message.into(), span: None, hint: Hint::None, value: None }
    }

    /// The same, with what to do.
    pub fn hint(mut self, hint: impl Into<Hint>) -> Self {
        self.hint = hint.into();
        self
    }
}

/// Everything that is wrong with a pipeline, and the texts it stands in.
#[derive(Clone, Debug)]
pub struct Problems {
    /// The texts.
    pub sources: Sources,
    /// The problems, in the order of the files.
    pub list: Vec<Problem>,
}

/// Maximum number of problems that are shown; the others are counted.
pub const MOST_SHOWN: usize = 50;

impl Problems {
    /// Sorts by place and drops repetitions.
    pub fn new(sources: Sources, mut list: Vec<Problem>) -> Self {
        list.sort_by(|a, b| (a.span, &a.message).cmp(&(b.span, &b.message)));
        list.dedup_by(|a, b| a.span == b.span && a.message == b.message);
        Self { sources, list }
    }

    /// The first fifty problems as text: message, `file:line:column`, the source line underlined, and a hint.
    pub fn render(&self, color: bool) -> String {
        let theme = if color { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
        let handler = GraphicalReportHandler::new_themed(theme).with_width(110).with_context_lines(1).with_links(false);
        let mut out = String::new();
        for problem in self.list.iter().take(MOST_SHOWN) {
            let report = Report { problem, sources: &self.sources };
            if handler.render_report(&mut out, &report).is_err() {
                out.push_str(&problem.message);
            }
            out.push('\n');
        }
        let count = self.list.len();
        out.push_str(&format!("{count} problem{} found", if count == 1 { "" } else { "s" }));
        out.push_str(&if count > MOST_SHOWN { format!("; the first {MOST_SHOWN} are shown\n") } else { "\n".into() });
        // The handler pads lines; trailing blanks help nobody.
        let lines: Vec<&str> = out.lines().map(str::trim_end).collect();
        lines.join("\n") + "\n"
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(false))
    }
}

impl std::error::Error for Problems {}

struct Report<'a> {
    problem: &'a Problem,
    sources: &'a Sources,
}

impl fmt::Debug for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.problem.message)
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.problem.message)
    }
}

impl std::error::Error for Report<'_> {}

impl miette::Diagnostic for Report<'_> {
    fn help<'b>(&'b self) -> Option<Box<dyn fmt::Display + 'b>> {
        let value = self.problem.value.as_ref().map(|v| format!("{}, set at {}", v.text, self.sources.place(v.set)));
        let lines: Vec<String> = self.problem.hint.text().into_iter().chain(value).collect();
        (!lines.is_empty()).then(|| Box::new(lines.join("\n")) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.problem.span.map(|_| self as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let span = self.problem.span?;
        let text = self.sources.text(span.source);
        let end = near(text, span.start, span.start + span.len.min(SHOWN));
        let len = end.saturating_sub(span.start);
        Some(Box::new(std::iter::once(LabeledSpan::new_primary_with_span(None, (span.start, len)))))
    }
}

impl SourceCode for Report<'_> {
    /// The span itself, for its place; with context, the whole lines that it stands on, and no others. For very long
    /// lines, only the surroundings are shown.
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        before: usize,
        after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let source = self.problem.span.map(|s| s.source).ok_or(MietteError::OutOfBounds)?;
        let text = self.sources.text(source);
        let (start, end) = (span.offset().min(text.len()), (span.offset() + span.len()).min(text.len()));
        let whole = if before + after > 0 {
            let line = text[..start].rfind('\n').map_or(0, |i| i + 1);
            let until = text[end..].find('\n').map_or(text.len(), |i| end + i);
            let from = near(text, line, start.saturating_sub(SHOWN));
            let until = near(text, end, until.min(end + SHOWN));
            SourceSpan::from((from, until - from))
        } else {
            *span
        };
        self.sources.texts[source].read_span(&whole, 0, 0)
    }
}

/// Bytes of a line that are shown before and after what is meant, and of that itself.
const SHOWN: usize = 100;

/// The first character that begins at `at` or after it, but not before `least`.
fn near(text: &str, least: usize, at: usize) -> usize {
    let at = at.max(least).min(text.len());
    (at..=text.len()).find(|at| text.is_char_boundary(*at)).unwrap_or(text.len())
}

/// The nearest of `names` to `wanted` by edit distance, if it is near enough to be meant.
pub fn nearest<'a>(wanted: &str, names: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Any two names of one or two letters are near each other, which says nothing.
    let length = wanted.chars().count();
    let limit = if length < 3 { 0 } else { length.div_ceil(3) };
    let lower = wanted.to_lowercase();
    // The distance takes time in proportion to both lengths, and is at least what they differ by.
    let could_be = |name: &&str| name.chars().count().abs_diff(length) <= limit || name.contains(wanted);
    names
        .into_iter()
        .filter(could_be)
        .map(|name| (osa_distance(&lower, &name.to_lowercase()), name))
        .filter(|(d, name)| *d <= limit || (wanted.len() >= 3 && name.contains(wanted)))
        .min()
        .map(|(_, name)| name)
}

/// A hint that names the nearest, or else lists all.
pub fn did_you_mean<'a>(wanted: &str, what: &str, names: impl IntoIterator<Item = &'a str> + Clone) -> String {
    if let Some(near) = nearest(wanted, names.clone()) {
        return format!("did you mean `{near}`?");
    }
    let all: Vec<String> = names.into_iter().map(|n| format!("`{n}`")).collect();
    if all.is_empty() { format!("there are no {what}") } else { format!("{what}: {}", listed(&all)) }
}

/// Names with commas between them; of very many the first fifty.
pub fn listed(names: &[String]) -> String {
    let shown = names[..names.len().min(MOST_SHOWN)].join(", ");
    if names.len() > MOST_SHOWN { format!("{shown}, and {} more", names.len() - MOST_SHOWN) } else { shown }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_names_are_found_and_far_ones_are_not() {
        assert_eq!(nearest("lad", ["lda", "ladies"]), Some("lda"), "neighbours that are swapped are one edit");
        assert_eq!(nearest("ladder_rendring", ["quality_gate", "ladder_rendering"]), Some("ladder_rendering"));
        assert_eq!(nearest("xyz", ["quality_gate", "ladder_rendering"]), None);
    }

    #[test]
    fn places_count_lines_and_characters() {
        let mut sources = Sources::default();
        let source = sources.add("f.yaml", "a: ä\nbc: 1\n");
        assert_eq!(sources.place(Span { source, start: 6, len: 2 }), "f.yaml:2:1");
    }
}
