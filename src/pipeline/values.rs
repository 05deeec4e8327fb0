//! Named values: `values: { last_rung: 256 }`, referred to as `$last_rung`.
//!
//! A use is a whole text: `$name` and nothing else. `$$` begins a text that begins with `$`; any other text is itself.
//! A value may be of any sort and may use other values. Substituted values keep the position of the reference, so that
//! problems are shown there; [`Values::explain`] adds the position of the definition. Knows no kind and no node.

use super::{
    file::PipelineFile,
    reference::is_name,
    yaml::{Data, Key, Yaml},
};
use crate::diagnostics::{Hint, NamedValue, Problem, Span, nearest};
use std::{
    collections::{HashMap, HashSet},
    rc::Rc,
    sync::Arc,
};

/// Maximum number of substituted values (maps, lists, scalars), the same as the limit for a file.
const MOST_PUT_IN: usize = 200_000;
/// Maximum bytes of text in substituted values, the same as the limit for a file.
const MOST_PUT_IN_BYTES: usize = 16 << 20;
/// Values may use each other so deep.
const DEEPEST_CHAIN: usize = 16;
/// A value may be nested so deep, as deep as a file.
const DEEPEST: usize = 48;

/// The meaning of a text.
#[derive(Debug, PartialEq)]
enum Form<'a> {
    /// Itself.
    Plain,
    /// This text, after `$$` became `$`.
    Escaped(&'a str),
    /// A value of this name.
    Use(&'a str),
}

fn form(text: &str) -> Form<'_> {
    match text.strip_prefix('$') {
        Some(rest) if rest.starts_with('$') => Form::Escaped(rest),
        Some(name) if is_name(name) => Form::Use(name),
        _ => Form::Plain,
    }
}

/// The named values of a file, and where they were used.
pub(super) struct Values {
    entries: Vec<Entry>,
    index: HashMap<String, usize>,
    names: Arc<[String]>,
    /// The value that stands at each use.
    uses: HashMap<Span, usize>,
    /// Uses that could not be followed.
    broken: HashSet<Span>,
    failures: usize,
    put_in: usize,
    put_in_bytes: usize,
    problems: Vec<Problem>,
}

struct Entry {
    key: Key,
    /// The value as it is written, for messages.
    shown: Option<String>,
    state: State,
    used: bool,
}

enum State {
    Written(Yaml),
    /// It is being worked out, as part of these.
    Busy,
    Done(Rc<Done>),
    Broken,
}

/// A value without uses.
struct Done {
    yaml: Yaml,
    nodes: usize,
    bytes: usize,
    /// Uses below each other that it took.
    chain: usize,
}

impl Values {
    /// Takes the values out of a file, and works them out.
    pub fn new(file: &mut PipelineFile) -> Self {
        let written = std::mem::take(&mut file.values);
        let mut values = Self {
            index: written.iter().enumerate().map(|(i, (key, _))| (key.text.clone(), i)).collect(),
            names: written.iter().map(|(key, _)| key.text.clone()).collect(),
            entries: written.into_iter().map(Entry::new).collect(),
            uses: HashMap::new(),
            broken: HashSet::new(),
            failures: 0,
            put_in: 0,
            put_in_bytes: 0,
            problems: Vec::new(),
        };
        for index in 0..values.entries.len() {
            values.work_out(index, &mut Vec::new());
        }
        for before in std::mem::take(&mut file.replaced) {
            values.fill(before);
        }
        values
    }

    /// The same with every use replaced by its value.
    pub fn fill(&mut self, yaml: Yaml) -> Yaml {
        self.walk(yaml, &mut Vec::new(), &mut 0)
    }

    fn walk(&mut self, yaml: Yaml, trail: &mut Vec<usize>, chain: &mut usize) -> Yaml {
        let Yaml { data, span } = yaml;
        let data = match data {
            Data::Text(text) => match form(&text) {
                Form::Plain => Data::Text(text),
                Form::Escaped(rest) => Data::Text(rest.to_owned()),
                Form::Use(name) => return self.put(name, span, trail, chain),
            },
            Data::List(items) => Data::List(items.into_iter().map(|item| self.walk(item, trail, chain)).collect()),
            Data::Map(fields) => {
                Data::Map(fields.into_iter().map(|(key, value)| (key, self.walk(value, trail, chain))).collect())
            }
            plain => plain,
        };
        Yaml { data, span }
    }

    /// The value of a use; nothing, after a problem, if it has none.
    fn put(&mut self, name: &str, span: Span, trail: &mut Vec<usize>, chain: &mut usize) -> Yaml {
        let nothing = Yaml { data: Data::Null, span };
        let Some(&index) = self.index.get(name) else {
            let hint = match nearest(name, self.names.iter().map(String::as_str)) {
                Some(near) => format!("did you mean `${near}`?"),
                None => format!("add `values: {{ {name}: ... }}`; a text that begins with `$` is written `$${name}`"),
            };
            return self.refuse(span, format!("unknown value `{name}`"), hint, nothing);
        };
        self.entries[index].used = true;
        if matches!(self.entries[index].state, State::Busy) {
            let from = trail.iter().position(|of| *of == index).unwrap_or(0);
            let circle: Vec<String> =
                trail[from..].iter().chain([&index]).map(|of| format!("${}", self.entries[*of].key.text)).collect();
            let message = format!("cyclic values: {}", circle.join(" -> "));
            return self.refuse(span, message, "write one of them out", nothing);
        }
        let too_deep = format!("values refer to each other more than {DEEPEST_CHAIN} levels deep");
        if trail.len() >= DEEPEST_CHAIN {
            return self.refuse(span, too_deep, "write one of them out", nothing);
        }
        let Some(done) = self.work_out(index, trail) else {
            // Its own place says why.
            return self.leave(span, nothing);
        };
        *chain = (*chain).max(done.chain + 1);
        if *chain > DEEPEST_CHAIN {
            return self.refuse(span, too_deep, "write one of them out", nothing);
        }
        if self.put_in + done.nodes > MOST_PUT_IN {
            let message = format!("more than {MOST_PUT_IN} values are substituted for names");
            return self.refuse(span, message, "shorten the named lists and maps, or use them less often", nothing);
        }
        if self.put_in_bytes + done.bytes > MOST_PUT_IN_BYTES {
            let message = format!("more than {} MiB of text are substituted for names", MOST_PUT_IN_BYTES >> 20);
            return self.refuse(span, message, "shorten the named texts, or use them less often", nothing);
        }
        self.put_in += done.nodes;
        self.put_in_bytes += done.bytes;
        self.uses.insert(span, index);
        done.yaml.standing_at(span)
    }

    fn refuse(&mut self, span: Span, message: String, hint: impl Into<Hint>, nothing: Yaml) -> Yaml {
        self.problems.push(Problem::at(span, message).hint(hint));
        self.leave(span, nothing)
    }

    fn leave(&mut self, span: Span, nothing: Yaml) -> Yaml {
        self.broken.insert(span);
        self.failures += 1;
        nothing
    }

    /// A value without uses; none if it is broken.
    fn work_out(&mut self, index: usize, trail: &mut Vec<usize>) -> Option<Rc<Done>> {
        match &self.entries[index].state {
            State::Done(done) => return Some(done.clone()),
            State::Broken | State::Busy => return None,
            State::Written(_) => {}
        }
        let State::Written(yaml) = std::mem::replace(&mut self.entries[index].state, State::Busy) else {
            return None; // looked at right above
        };
        trail.push(index);
        let (before, mut chain) = (self.failures, 0);
        let yaml = self.walk(yaml, trail, &mut chain);
        trail.pop();
        let (nodes, depth) = yaml.size();
        if depth > DEEPEST {
            let message =
                format!("the value `{}` is nested more than {DEEPEST} levels deep", self.entries[index].key.text);
            let span = self.entries[index].key.span;
            self.problems.push(Problem::at(span, message).hint("use fewer levels"));
        } else if self.failures == before {
            let done = Rc::new(Done { bytes: yaml.bytes(), yaml, nodes, chain });
            self.entries[index].state = State::Done(done.clone());
            return Some(done);
        }
        self.entries[index].state = State::Broken;
        None
    }

    /// Says of each problem at a use where the value is set, and adds problems of the uses themselves, which hide those
    /// that follow from them.
    pub fn explain(&mut self, problems: &mut Vec<Problem>) {
        problems.retain(|problem| problem.span.is_none_or(|span| !self.broken.contains(&span)));
        for problem in problems.iter_mut() {
            if let Some(index) = problem.span.and_then(|span| self.uses.get(&span)) {
                let Entry { key, shown, .. } = &self.entries[*index];
                let is = shown.as_ref().map(|shown| format!(" is {shown}")).unwrap_or_default();
                problem.value = Some(NamedValue { text: format!("`${}`{is}", key.text), set: key.span });
            }
        }
        problems.append(&mut self.problems);
        // If there are other problems, the reference may be in an unreadable part.
        if problems.is_empty() {
            for Entry { key, .. } in self.entries.iter().filter(|entry| !entry.used) {
                let used = self.entries.iter().filter(|entry| entry.used).map(|entry| entry.key.text.as_str());
                let hint = match nearest(&key.text, used) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("use it as `${}`, or remove it", key.text),
                };
                problems.push(Problem::at(key.span, format!("the value `{}` is never used", key.text)).hint(hint));
            }
        }
    }
}

impl Entry {
    fn new((key, yaml): (Key, Yaml)) -> Self {
        let shown = match &yaml.data {
            Data::List(_) | Data::Map(_) => None,
            Data::Text(text) if text.chars().count() > 40 => None,
            _ => Some(format!("`{}`", yaml.to_json())),
        };
        Self { key, shown, state: State::Written(yaml), used: false }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_whole_text_is_a_use() {
        assert_eq!(form("$last_rung"), Form::Use("last_rung"));
        assert_eq!(form("$$last_rung"), Form::Escaped("$last_rung"));
        assert_eq!(form("$$$"), Form::Escaped("$$"));
        for plain in ["", "$", "$5", "$a b", "a$b", "${a}", "$a.b", " $a"] {
            assert_eq!(form(plain), Form::Plain, "{plain}");
        }
    }
}
