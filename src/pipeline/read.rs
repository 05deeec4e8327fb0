//! Reads maps, texts and names from YAML, and reports wrong types.

use super::{
    reference::{MOST_LETTERS, is_name},
    yaml::{Data, Key, Yaml},
};
use crate::diagnostics::Problem;

/// The rules for names, as a hint.
const NAME_HINT: &str = "use letters, digits, `_` and `-`, starting with a letter";

/// The fields of a map; none of what is no map.
pub fn map(value: Yaml, what: &str, problems: &mut Vec<Problem>) -> Vec<(Key, Yaml)> {
    match value.data {
        Data::Map(fields) => fields,
        Data::Null => Vec::new(),
        _ => {
            let message = format!("{what} must be a map, found {}", value.sort());
            problems.push(Problem::at(value.span, message).hint("write `key: value` lines below it"));
            Vec::new()
        }
    }
}

/// A text, or a list of texts.
pub fn texts(value: &Yaml, what: &str, problems: &mut Vec<Problem>) -> Vec<Key> {
    let mut found = Vec::new();
    let single = std::slice::from_ref(value);
    let items = if let Data::List(items) = &value.data { items } else { single };
    for item in items {
        match &item.data {
            Data::Text(text) => found.push(Key { text: text.clone(), span: item.span }),
            _ => {
                let message = format!("{what}: expected a text or a list of texts, found {}", item.sort());
                problems.push(Problem::at(item.span, message).hint("write a name, or `[a, b]`"));
            }
        }
    }
    found
}

/// A name.
pub fn name(value: &Yaml, what: &str, problems: &mut Vec<Problem>) -> Option<Key> {
    if let Data::Text(text) = &value.data {
        if is_name(text) {
            return Some(Key { text: text.clone(), span: value.span });
        }
        let hint =
            if text.starts_with('$') { "named values are not allowed here; write out the value" } else { hint(text) };
        problems.push(Problem::at(value.span, format!("`{text}` cannot be used as {what}")).hint(hint));
    } else {
        let message = format!("{what} must be a text, found {}", value.sort());
        problems.push(Problem::at(value.span, message).hint("write a name, in quotes if it looks like a number"));
    }
    None
}

/// Whether a key can name what it names; a problem if not.
pub fn check_name(key: &Key, what: &str, problems: &mut Vec<Problem>) {
    if !is_name(&key.text) {
        problems.push(Problem::at(key.span, format!("`{}` cannot name {what}", key.text)).hint(hint(&key.text)));
    }
}

/// What is wrong with a text that is no name.
fn hint(text: &str) -> &'static str {
    if text.len() > MOST_LETTERS { "use at most 100 letters" } else { NAME_HINT }
}
