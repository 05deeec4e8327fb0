//! The frame of the page: head, style, navigation, tabs without scripts. Knows no section's content.

use crate::{
    ranking::{COLOURS, palette},
    text::{escape, plural},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_contract::Collection;

const STYLE: &str = include_str!("style.css");

/// Where the published copy of a page is given a line on the run that wrote it.
const RUN: &str = "<!--tauflow:run-->";

/// A part of the page under its own heading.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Anchor, of letters and dashes.
    pub id: &'static str,
    /// Heading.
    pub title: String,
    /// HTML below the heading.
    pub body: String,
    /// CSS class, empty for none.
    pub class: &'static str,
}

impl Section {
    /// A section without a class.
    pub fn new(id: &'static str, title: impl Into<String>, body: String) -> Self {
        Self { id, title: title.into(), body, class: "" }
    }
}

/// Panels of which one is seen at a time, chosen by radio buttons; on paper, all of them. `name` is unique on the page.
pub fn tabs(name: &str, panels: &[(String, String)]) -> String {
    if let [(_, only)] = panels {
        return only.clone();
    }
    let mut out = format!(r#"<div class="tabs" id="tabs-{name}">"#);
    for (i, (label, _)) in panels.iter().enumerate() {
        let checked = if i == 0 { " checked" } else { "" };
        let _ = write!(
            out,
            r#"<input type="radio" name="{name}" id="{name}-{i}"{checked}><label for="{name}-{i}">{}</label>"#,
            escape(label)
        );
    }
    for (i, (label, body)) in panels.iter().enumerate() {
        let _ = write!(out, r#"<div class="tab t{i}"><h3 class="name">{}</h3>{body}</div>"#, escape(label));
    }
    out.push_str("<style>");
    for i in 0..panels.len() {
        let comma = if i == 0 { "" } else { "," };
        let _ = write!(out, "{comma}#{name}-{i}:checked~.t{i}");
    }
    out.push_str("{display:block}</style></div>");
    out
}

/// Rules for the classes of colours, and for those of the methods on the page: as a line, as a filled shape, as text.
fn colours(html: &str) -> String {
    let plain = (0..COLOURS).map(|i| format!("m{i}")).chain(["hold", "ink", "soft", "neg"].map(str::to_owned));
    let plain = plain.map(|name| (name.clone(), name));
    let mut out = String::new();
    for (class, name) in plain.chain(palette(html)) {
        let _ = write!(
            out,
            "svg .line.{class}{{stroke:var(--{name})}}svg .band.{class},svg .dot.{class},svg .end.{class}\
             {{fill:var(--{name})}}.key.{class},.bar .{class}{{background:var(--{name})}}"
        );
    }
    out
}

/// The line below the abstract: the content of the page's inputs by digest, and where the run is described. The page
/// itself must not name the run, as equal inputs give equal pages.
pub fn provenance(inputs: &BTreeMap<&str, &Collection>) -> String {
    let of = |(port, items): (&&str, &&Collection)| {
        let mut items = items.iter();
        let told = match (items.next(), items.count()) {
            (None, _) => "nothing".to_owned(),
            (Some((_, only)), 0) => only.digest().short(),
            (Some(_), more) => plural(more as u64 + 1, "item"),
        };
        format!("{} {}", escape(port), escape(&told))
    };
    format!(
        "<p class=\"note provenance\"><b>Provenance.</b>{RUN} Inputs by content: {}. The run is on \
         <code>index.html</code> beside this page, and in <code>tauflow runs --json</code>.</p>",
        inputs.iter().map(of).collect::<Vec<_>>().join(", ")
    )
}

/// The whole page. `missing` are lines on what was not connected, `beside` says in HTML which files have the figures.
pub fn page(title: &str, header: &str, sections: &[Section], missing: &[String], beside: &str) -> String {
    let mut out = String::from("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">");
    out.push_str(r#"<meta name="viewport" content="width=device-width, initial-scale=1">"#);
    out.push_str(r#"<meta name="generator" content="tauflow">"#);
    let _ = write!(out, "<title>{}</title><style>{STYLE}</style></head>\n<body>", escape(title));
    let _ = write!(out, "<header class=\"top\"><h1>{}</h1>{header}<nav>", escape(title));
    for section in sections {
        let _ = write!(out, "<a href=\"#{}\">{}</a>", section.id, escape(&section.title));
    }
    out.push_str("</nav></header>\n<main>");
    for Section { id, title, body, class } in sections {
        let class = if class.is_empty() { String::new() } else { format!(" class=\"{class}\"") };
        let _ = writeln!(out, "<section id=\"{id}\"{class}><h2>{}</h2>{body}</section>", escape(title));
    }
    out.push_str("</main>\n<footer>");
    if !missing.is_empty() {
        let _ = write!(
            out,
            "<p class=\"missing\">Omitted, because these inputs are not connected: {}.</p>",
            escape(&missing.join("; "))
        );
    }
    let _ = writeln!(
        out,
        "<p>Made by tauflow. All results are reproducible from the pipeline and its inputs, except sections marked as \
         measured. The same values are next to this page, in {beside}.</p></footer></body></html>"
    );
    let style = format!("{}</style></head>", colours(&out));
    out.replacen("</style></head>", &style, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_are_escaped_and_tabs_need_no_script() {
        let panels = [("a<b".to_owned(), "<p>1</p>".to_owned()), ("c".to_owned(), "<p>2</p>".to_owned())];
        let section = Section::new("x", "T<1>", tabs("t", &panels));
        let page = page("<script>", "", &[section], &["x".into()], "<code>a.json</code>");
        assert!(
            page.contains("<title>&lt;script&gt;</title>") && page.contains("T&lt;1&gt;") && page.contains("a&lt;b")
        );
        assert!(page.contains("next to this page, in <code>a.json</code>."));
        assert!(!page.contains("<script") && page.contains("#t-1:checked~.t1"));
        assert_eq!(tabs("t", &panels[..1]), "<p>1</p>");
    }
}
