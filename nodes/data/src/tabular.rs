//! Fields of tables as text: CSV (RFC 4180) and LaTeX. Knows no table.

use crate::records::Estimate;

/// A CSV field, quoted where it must be.
pub fn csv_field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

/// Three CSV fields: mean, low and high. The last two are empty without an interval, all of them without an estimate.
pub fn csv_estimate(estimate: Option<&Estimate>, has_interval: bool) -> String {
    match estimate {
        None => ",,".to_owned(),
        Some(of) if has_interval => format!("{},{},{}", of.mean, of.low, of.high),
        Some(of) => format!("{},,", of.mean),
    }
}

/// Text that is safe in LaTeX.
pub fn tex_escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '\\' => out.push_str(r"\textbackslash{}"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            '~' => out.push_str(r"\textasciitilde{}"),
            '^' => out.push_str(r"\textasciicircum{}"),
            '<' => out.push_str(r"\textless{}"),
            '>' => out.push_str(r"\textgreater{}"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn awkward_csv_fields_are_quoted() {
        assert_eq!(csv_field("a,b"), "\"a,b\"");
        assert_eq!(csv_field("a\"b"), "\"a\"\"b\"");
        assert_eq!(csv_field("plain"), "plain");
    }

    #[test]
    fn estimates_have_three_fields_whatever_is_known() {
        let of = Estimate { mean: 1.5, low: 1.0, high: 2.0 };
        assert_eq!(csv_estimate(Some(&of), true), "1.5,1,2");
        assert_eq!((csv_estimate(Some(&of), false), csv_estimate(None, true)), ("1.5,,".into(), ",,".into()));
    }

    #[test]
    fn special_characters_are_escaped_for_latex() {
        assert_eq!(tex_escape(r"a_b & 5% \x"), r"a\_b \& 5\% \textbackslash{}x");
    }
}
