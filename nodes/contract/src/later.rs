//! Params that were added to a kind after its first version.
//!
//! One value of such a param reproduces the behaviour before it existed: a constant next to the param, independent of
//! the current default. A param with this value is omitted from keys, checkpoints and logs, so that older ones stay
//! valid. If it is omitted, the action receives this value.

use serde_json::{Map, Value};

/// A param that came later.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Later {
    /// JSON pointer into the params, e.g. `/rung_exponent`.
    pub pointer: &'static str,
    /// The value that acted before it existed.
    pub before: Before,
}

/// A plain JSON value as a constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Before {
    /// Nothing.
    Null,
    /// A truth value.
    Flag(bool),
    /// A whole number.
    Integer(i64),
    /// Any other number.
    Number(f64),
    /// A text, such as the name of a choice.
    Text(&'static str),
    /// A list of whole numbers, such as a range.
    Integers(&'static [i64]),
}

impl Before {
    /// The value as JSON.
    pub fn value(self) -> Value {
        match self {
            Self::Null => Value::Null,
            Self::Flag(flag) => flag.into(),
            Self::Integer(number) => number.into(),
            Self::Number(number) => number.into(),
            Self::Text(text) => text.into(),
            Self::Integers(numbers) => numbers.into(),
        }
    }
}

impl Later {
    /// The object that holds the param, if it is there, and the param's name.
    fn place<'a>(&self, params: &'a mut Value) -> Option<(&'a mut Map<String, Value>, &'static str)> {
        let (parent, name) = self.pointer.rsplit_once('/')?;
        Some((params.pointer_mut(parent)?.as_object_mut()?, name))
    }
}

/// Takes the params that came later out where they have the value of before.
pub fn leave_out(params: &mut Value, later: &[Later]) {
    for param in later {
        if let Some((fields, name)) = param.place(params)
            && fields.get(name) == Some(&param.before.value())
        {
            fields.remove(name);
        }
    }
}

/// Puts the value of before where a param that came later is left out: what [`leave_out`] took, and no default.
pub fn fill_in(params: &mut Value, later: &[Later]) {
    for param in later {
        if let Some((fields, name)) = param.place(params) {
            fields.entry(name).or_insert_with(|| param.before.value());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use serde_json::json;

    const LATER: &[Later] = &[
        Later { pointer: "/exponent", before: Before::Number(0.0) },
        Later { pointer: "/output", before: Before::Text("means") },
        Later { pointer: "/rate/floor", before: Before::Null },
        Later { pointer: "/views", before: Before::Integer(1) },
        Later { pointer: "/shared", before: Before::Flag(false) },
        Later { pointer: "/range", before: Before::Integers(&[1, 1]) },
    ];

    fn without(mut params: Value) -> Value {
        leave_out(&mut params, LATER);
        params
    }

    #[test]
    fn only_values_of_before_are_left_out() {
        let before = json!({"exponent": 0.0, "output": "means", "rate": {"floor": null}, "views": 1, "shared": false,
            "range": [1, 1]});
        assert_eq!(without(before), json!({"rate": {}}));
        let other = json!({"exponent": 0.5, "output": "values", "rate": {"floor": 1}, "views": 2, "shared": true,
            "range": [1, 2]});
        assert_eq!(without(other.clone()), other);
        assert_eq!(without(json!({"rate": 3, "steps": 7})), json!({"rate": 3, "steps": 7}));
        assert_eq!(without(json!(null)), json!(null));
    }

    /// Params as they are today: the default of a param that came later is not what acted before.
    #[derive(Serialize, Deserialize)]
    #[serde(default)]
    struct Today {
        views: u64,
    }

    impl Default for Today {
        fn default() -> Self {
            Self { views: 8 }
        }
    }

    #[test]
    fn a_changed_default_does_not_change_what_is_left_out() {
        let keyed = |views| without(serde_json::to_value(Today { views }).expect("plain"));
        assert_eq!(keyed(8), json!({"views": 8}), "today's default is told");
        assert_eq!(keyed(1), json!({}), "the value of before is not");
        let acts = |views| {
            let mut params = keyed(views);
            fill_in(&mut params, LATER);
            serde_json::from_value::<Today>(params).expect("params").views
        };
        assert_eq!([acts(8), acts(1), acts(2)], [8, 1, 2], "an action does what its params say");
    }
}
