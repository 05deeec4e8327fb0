//! References in inputs: `node`, `node.port`, `node[axis=value, axis2=value].port`.

/// A parsed reference; its texts are slices of the source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reference<'a> {
    /// The node.
    pub node: &'a str,
    /// Cells that are picked, by axis.
    pub select: Vec<(&'a str, &'a str)>,
    /// The output port, if it is not the default.
    pub port: Option<&'a str>,
}

impl<'a> Reference<'a> {
    /// Parses a reference.
    ///
    /// # Errors
    /// Its error, in words.
    pub fn parse(text: &'a str) -> Result<Self, String> {
        let name = |part: &'a str, what: &str| -> Result<&'a str, String> {
            let part = part.trim();
            if is_name(part) { Ok(part) } else { Err(format!("`{part}` is not a valid name of {what}")) }
        };
        let (head, port) = match text.rfind(']').map_or_else(|| text.find('.'), |i| text[i..].find('.').map(|j| i + j))
        {
            Some(dot) => (&text[..dot], Some(name(&text[dot + 1..], "a port")?)),
            None => (text, None),
        };
        let Some((node, rest)) = head.split_once('[') else {
            return Ok(Self { node: name(head, "a node")?, select: Vec::new(), port });
        };
        let inside = rest.trim_end().strip_suffix(']').ok_or("the bracket `[` is not closed")?;
        let mut select: Vec<(&str, &str)> = Vec::new();
        for pair in inside.split(',') {
            let (axis, value) = pair.split_once('=').ok_or(format!("`{}` is not `axis=value`", pair.trim()))?;
            let axis = name(axis, "an axis")?;
            if select.iter().any(|(a, _)| *a == axis) {
                return Err(format!("the axis `{axis}` is given twice"));
            }
            select.push((axis, value.trim()));
        }
        Ok(Self { node: name(node, "a node")?, select, port })
    }
}

/// Names become names of folders and files, with more around them; file systems take 255 bytes.
pub const MOST_LETTERS: usize = 100;

/// Whether a text can name a node, port, axis, value or profile: at most 100 letters, digits, `_` and `-`, not starting
/// with a digit or `-`.
pub fn is_name(text: &str) -> bool {
    text.len() <= MOST_LETTERS && is_word(text)
}

/// The same of a text of any length.
pub fn is_word(text: &str) -> bool {
    let mut chars = text.chars();
    chars.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && chars.all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms() {
        let plain = Reference::parse("gate").expect("valid");
        assert_eq!(plain, Reference { node: "gate", select: vec![], port: None });
        let port = Reference::parse("gate.accepted").expect("valid");
        assert_eq!(port, Reference { node: "gate", select: vec![], port: Some("accepted") });
        let cell = Reference::parse("solvers[p=mc_noise, s=0.5].model").expect("valid");
        let select = vec![("p", "mc_noise"), ("s", "0.5")];
        assert_eq!(cell, Reference { node: "solvers", select, port: Some("model") });
        assert!(is_name(&"a".repeat(100)) && !is_name(&"a".repeat(101)));
        for bad in ["", "a b", "a.b.c", "a[p=1", "a[p]", "a[p=1,p=2]", "a[].x", "a."] {
            assert!(Reference::parse(bad).is_err(), "{bad}");
        }
    }
}
