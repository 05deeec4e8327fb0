//! pbrt-v4 files as directives with their parameters, files included. Knows no directive but `Include` and `Import`.
//!
//! Source: pbrt-v4's documentation of its file format, and its `parser.cpp`. Paths are relative to the main file.

use crate::scene_files::{
    given::{Given, text_of},
    problems::{Place, Problems},
};
use std::{
    cell::{Cell, OnceCell},
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

/// A parameter's values.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Numbers.
    Numbers(Vec<f64>),
    /// Quoted texts.
    Texts(Vec<String>),
    /// `true` and `false`.
    Bools(Vec<bool>),
}

/// A parameter: `"float fov" [ 45 ]`.
#[derive(Clone, Debug)]
pub struct Param {
    /// Its declared type.
    pub sort: String,
    /// Its name.
    pub name: String,
    /// Its type.
    pub values: Values,
    /// Where it stands.
    pub at: Place,
    /// True once somebody read it.
    pub used: Cell<bool>,
}

/// A directive: `Shape "sphere" "float radius" 2`.
#[derive(Clone, Debug)]
pub struct Directive {
    /// Its name.
    pub name: String,
    /// Where it stands.
    pub at: Place,
    /// Quoted texts before its parameters.
    pub texts: Vec<String>,
    /// Numbers before its parameters.
    pub numbers: Vec<f64>,
    /// Its parameters.
    pub params: Vec<Param>,
    /// The first parameter of each name, of a directive with many: it may be used thousands of times.
    index: OnceCell<BTreeMap<String, usize>>,
    /// True once parameters that nobody read were told.
    pub told: Cell<bool>,
}

/// Parameters up to which looking at each is quick.
const FEW: usize = 16;

impl Directive {
    fn new(name: &str, at: Place) -> Self {
        let (texts, numbers, params) = (Vec::new(), Vec::new(), Vec::new());
        Self { name: name.to_owned(), at, texts, numbers, params, index: OnceCell::new(), told: Cell::new(false) }
    }

    /// A parameter by name: the first, if there are several.
    pub fn param(&self, name: &str) -> Option<&Param> {
        if self.params.len() <= FEW {
            return self.params.iter().find(|param| param.name == name);
        }
        let index = self.index.get_or_init(|| {
            let named = self.params.iter().enumerate().rev().map(|(number, param)| (param.name.clone(), number));
            named.collect()
        });
        self.params.get(*index.get(name)?)
    }

    /// Its name and the first text behind it.
    pub fn quoted(&self) -> String {
        match self.texts.first() {
            Some(text) => format!("`{} \"{text}\"`", self.name),
            None => format!("`{}`", self.name),
        }
    }
}

/// Types of parameters; a text of two words that begins with none of them is a name.
const TYPES: [&str; 17] = [
    "integer",
    "float",
    "point2",
    "vector2",
    "point3",
    "vector3",
    "normal",
    "normal3",
    "spectrum",
    "rgb",
    "blackbody",
    "bool",
    "string",
    "texture",
    "point",
    "vector",
    "color",
];

/// Deepest nesting of included files, most of them, and most directives and values.
const DEEPEST: usize = 16;
const MOST_INCLUDED: usize = 10_000;
const MOST_DIRECTIVES: usize = 1 << 22;
const MOST_VALUES: usize = 1 << 28;

/// Most bytes of files that are included again.
const MOST_AGAIN: usize = 1 << 25;

enum Token<'a> {
    Word(&'a str),
    Quoted(String),
    Open,
    Close,
}

struct Tokens<'a> {
    text: &'a str,
    line: u32,
}

impl<'a> Tokens<'a> {
    /// The next token with its line; an error is the line of a text without an end.
    fn next(&mut self) -> Option<Result<(Token<'a>, u32), u32>> {
        loop {
            let first = self.text.bytes().next()?;
            match first {
                b'\n' => {
                    self.line += 1;
                    self.text = &self.text[1..];
                }
                b'#' => self.text = &self.text[self.text.find('\n').unwrap_or(self.text.len())..],
                _ if first.is_ascii_whitespace() => self.text = &self.text[1..],
                _ => break,
            }
        }
        let line = self.line;
        let text = self.text;
        let (token, length) = match text.as_bytes()[0] {
            b'[' => (Token::Open, 1),
            b']' => (Token::Close, 1),
            b'"' => {
                let end = text[1..].find(['"', '\n']).filter(|end| text.as_bytes()[end + 1] == b'"');
                let Some(end) = end else {
                    self.text = "";
                    return Some(Err(line));
                };
                (Token::Quoted(text[1..=end].to_owned()), end + 2)
            }
            _ => {
                let stop = |c: char| c.is_ascii_whitespace() || matches!(c, '"' | '[' | ']' | '#');
                let end = text.find(stop).unwrap_or(text.len());
                (Token::Word(&text[..end]), end)
            }
        };
        self.text = &text[length..];
        Some(Ok((token, line)))
    }
}

/// A file with what it includes.
pub struct Parsed {
    /// All directives, in order.
    pub directives: Vec<Directive>,
    /// Every file that is named.
    pub files: BTreeSet<String>,
}

struct Parser<'a> {
    given: &'a Given<'a>,
    problems: &'a mut Problems,
    out: Parsed,
    included: usize,
    /// Bytes of files that were included again.
    again: usize,
    values: usize,
}

/// Reads a file and what it includes; what is wrong with it is told.
pub fn parse(name: &str, bytes: &[u8], given: &Given<'_>, problems: &mut Problems) -> Parsed {
    let out = Parsed { directives: Vec::new(), files: BTreeSet::new() };
    let mut parser = Parser { given, problems, out, included: 0, again: 0, values: 0 };
    parser.file(name, bytes, 0);
    parser.out
}

impl Parser<'_> {
    fn file(&mut self, name: &str, bytes: &[u8], depth: usize) {
        let file: Rc<str> = name.into();
        let Some(text) = text_of(bytes, &Place::file(name), self.problems) else { return };
        let mut tokens = Tokens { text, line: 1 };
        let mut current: Option<Directive> = None;
        loop {
            let token = match tokens.next() {
                Some(Ok(token)) => token,
                Some(Err(line)) => {
                    let at = Place { file: Rc::clone(&file), line };
                    self.problems.error(&at, "a text without its closing quote", "add one on the same line");
                    break;
                }
                None => break,
            };
            if self.out.directives.len() >= MOST_DIRECTIVES || self.values > MOST_VALUES {
                return self.problems.error(&Place::file(name), "too much of it", "write a smaller scene");
            }
            let at = Place { file: Rc::clone(&file), line: token.1 };
            match (token.0, &mut current) {
                (Token::Word(word), Some(directive)) if word.parse::<f64>().is_ok_and(f64::is_finite) => {
                    directive.numbers.push(word.parse().unwrap_or_default());
                }
                (Token::Word(word), _) if word.starts_with(|c: char| c.is_ascii_uppercase()) => {
                    if let Some(done) = current.replace(Directive::new(word, at)) {
                        self.done(done, depth);
                    }
                }
                (Token::Quoted(text), Some(directive)) => {
                    let words: Vec<&str> = text.split_ascii_whitespace().collect();
                    match words.as_slice() {
                        [sort, name] if TYPES.contains(sort) => {
                            let (sort, name) = ((*sort).to_owned(), (*name).to_owned());
                            let values = self.values(&mut tokens, &at);
                            directive.params.push(Param { sort, name, values, at, used: Cell::new(false) });
                        }
                        _ => directive.texts.push(text),
                    }
                }
                // Numbers in brackets, as of `Transform`.
                (Token::Open | Token::Close, Some(_)) => {}
                (Token::Word(word), _) => {
                    self.problems.error(&at, format!("`{word}`"), "a directive begins with a capital");
                }
                (_, None) => self.problems.error(&at, "values before any directive", "is it a pbrt-v4 file?"),
            }
        }
        if let Some(done) = current {
            self.done(done, depth);
        }
    }

    /// The values that follow a parameter's name.
    fn values(&mut self, tokens: &mut Tokens<'_>, at: &Place) -> Values {
        let (mut numbers, mut texts, mut bools) = (Vec::new(), Vec::new(), Vec::new());
        let mut open = false;
        loop {
            match tokens.next() {
                Some(Ok((Token::Open, _))) if !open => {
                    open = true;
                    continue;
                }
                Some(Ok((Token::Close, _))) if open => break,
                Some(Ok((Token::Quoted(text), _))) => match text.as_str() {
                    "true" | "false" => bools.push(text == "true"),
                    _ => texts.push(text),
                },
                Some(Ok((Token::Word("true"), _))) => bools.push(true),
                Some(Ok((Token::Word("false"), _))) => bools.push(false),
                Some(Ok((Token::Word(word), line))) => match word.parse::<f64>() {
                    Ok(number) if number.is_finite() => numbers.push(number),
                    _ => {
                        let at = Place { file: Rc::clone(&at.file), line };
                        self.problems.error(&at, format!("`{word}` is no value"), "write numbers, texts or booleans");
                    }
                },
                _ => {
                    self.problems.error(at, "values without their closing bracket, or none", "write `[ values ]`");
                    break;
                }
            }
            if !open {
                break;
            }
        }
        self.values += numbers.len() + texts.len() + bools.len();
        match (texts.is_empty(), bools.is_empty()) {
            (true, true) => Values::Numbers(numbers),
            (false, true) if numbers.is_empty() => Values::Texts(texts),
            (true, false) if numbers.is_empty() => Values::Bools(bools),
            _ => {
                self.problems.error(at, "values of several types", "write numbers, texts or booleans");
                Values::Numbers(Vec::new())
            }
        }
    }

    fn done(&mut self, directive: Directive, depth: usize) {
        for param in &directive.params {
            if let (Values::Texts(texts), "filename" | "normalmap") = (&param.values, param.name.as_str()) {
                self.out.files.extend(texts.iter().cloned());
            }
        }
        if directive.name != "Include" && directive.name != "Import" {
            return self.out.directives.push(directive);
        }
        let [path] = directive.texts.as_slice() else {
            return self.problems.error(&directive.at, "it names no file", "write `Include \"file.pbrt\"`");
        };
        self.included += 1;
        if depth >= DEEPEST || self.included > MOST_INCLUDED {
            let what = "too many files are included, or one in itself";
            return self.problems.error(&directive.at, what, "include less");
        }
        let again = !self.out.files.insert(path.clone());
        // Imports do not change the state.
        let alone = directive.name == "Import";
        let mark = |name: &str| Directive::new(name, directive.at.clone());
        if let Some(bytes) = self.given.read(path, &directive.at, self.problems) {
            self.again += if again { bytes.len() } else { 0 };
            if self.again > MOST_AGAIN {
                let file = Place::file(&directive.at.file);
                return self.problems.error(&file, "files are included again and again", "include less");
            }
            self.out.directives.extend(alone.then(|| mark("AttributeBegin")));
            self.file(path, &bytes, depth + 1);
            self.out.directives.extend(alone.then(|| mark("AttributeEnd")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str, more: &[(&str, &str)]) -> (Parsed, Result<Vec<String>, String>) {
        let parts = more.iter().map(|(name, text)| (crate::scene_files::given::part(name), text.as_bytes().to_vec()));
        let parts: BTreeMap<String, Vec<u8>> = parts.collect();
        let mut problems = Problems::new(false);
        let parsed = parse("a.pbrt", text.as_bytes(), &Given::Parts(&parts), &mut problems);
        (parsed, problems.finish().map_err(|e| e.to_string()))
    }

    #[test]
    fn directives_have_texts_numbers_and_parameters() {
        let text = "# hello\nLookAt 0 0 5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" [ 45.5 ] # end\n\
                    Shape \"trianglemesh\"\n \"point3 P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2]\n\
                    Material \"diffuse\" \"rgb reflectance\" [.1 .2 .3] \"bool remap\" false \"string a\" \"b\"\n\
                    Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1]\nInclude \"x/b.pbrt\"\nImport \"x/b.pbrt\"";
        let (parsed, told) = parsed(
            text,
            &[(
                "x/b.pbrt",
                "WorldBegin Texture \"t\" \"spectrum\" \"imagemap\" \
                                                          \"string filename\" \"c.png\"",
            )],
        );
        assert_eq!(told, Ok(Vec::new()));
        let names: Vec<(&str, u32)> = parsed.directives.iter().map(|d| (d.name.as_str(), d.at.line)).collect();
        let expected =
            [("LookAt", 2), ("Camera", 3), ("Shape", 4), ("Material", 6), ("Transform", 7), ("WorldBegin", 1)];
        assert_eq!(names[..6], expected);
        let rest: Vec<&str> = names[6..].iter().map(|n| n.0).collect();
        assert_eq!(rest, ["Texture", "AttributeBegin", "WorldBegin", "Texture", "AttributeEnd"]);
        assert_eq!(parsed.directives[0].numbers.len(), 9);
        assert_eq!(parsed.directives[4].numbers.len(), 16);
        let params = &parsed.directives[3].params;
        assert_eq!((params[0].sort.as_str(), params[0].name.as_str()), ("rgb", "reflectance"));
        assert_eq!(params[1].values, Values::Bools(vec![false]));
        assert_eq!(params[2].values, Values::Texts(vec!["b".into()]));
        assert_eq!(parsed.directives[6].texts, ["t", "spectrum", "imagemap"]);
        let files: Vec<&str> = parsed.files.iter().map(String::as_str).collect();
        assert_eq!(files, ["c.png", "x/b.pbrt"]);
    }

    #[test]
    fn damage_and_loops_are_told_with_their_lines() {
        for (text, line) in [
            ("Shape \"sphere", "line 1: a text without its closing quote"),
            ("Shape \"sphere\"\n\"float radius\" [ 1", "line 2: values without their closing bracket"),
            ("\nhello", "line 2: `hello`"),
            ("Include", "line 1: it names no file"),
            ("Include \"none.pbrt\"", "line 1: `none.pbrt` is no file"),
            ("Shape \"a\" \"float b\" [1 \"c\"]", "line 1: values of several types"),
        ] {
            let told = parsed(text, &[]).1.expect_err(text);
            assert!(told.contains(line), "{told}");
        }
        let told = parsed("Include \"b\"", &[("b", "Include \"b\"")]).1.expect_err("a loop");
        assert!(told.starts_with("b: line 1: too many files are included"), "{told}");
        let twice = "Include \"b\" Include \"b\"";
        assert!(parsed(twice, &[("b", twice)]).1.is_err(), "a bomb");
    }
}
