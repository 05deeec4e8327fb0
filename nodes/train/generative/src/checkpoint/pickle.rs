//! Reads a pickle as data. Pickles are programs: they name functions and call them. Here nothing is ever called. The
//! few names by which `torch.save` writes tensors are known; any other name is reported, and the file refused.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// A value; what has parts is an object of the [`Heap`]. Texts are shared: a small file can name a long one many times.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(Arc<str>),
    Object(usize),
}

/// What has parts.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Object {
    List(Vec<Value>),
    Tuple(Vec<Value>),
    Dict(Vec<(Value, Value)>),
    /// A function or class, by module and name.
    Global(Arc<str>, Arc<str>),
    /// A row of numbers in an entry of the archive.
    Storage {
        dtype: Arc<str>,
        entry: Arc<str>,
    },
    /// A view of a storage.
    Tensor(Tensor),
    /// Raw bytes.
    Bytes,
    /// What an unknown function would have made.
    Unknown,
}

/// A view of a storage.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tensor {
    /// The name of its class, such as `FloatStorage`.
    pub(super) dtype: Arc<str>,
    pub(super) entry: Arc<str>,
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

/// All objects of a pickle.
#[derive(Debug, Default)]
pub(super) struct Heap {
    objects: Vec<Object>,
    /// Names that are not known, the first of them, each once.
    foreign: Vec<String>,
    /// All of them.
    all_foreign: BTreeSet<String>,
}

/// Most names of functions that are told.
const MOST_TOLD: usize = 20;

/// Most bytes of the name of a function, and of that of its module.
const LONGEST_NAME: usize = 200;

/// Most axes of a tensor.
const MOST_AXES: usize = 8;

/// Entries of a dictionary, by text.
pub(super) type Named<'a> = Vec<(&'a str, &'a Value)>;

impl Heap {
    fn add(&mut self, object: Object) -> Value {
        self.objects.push(object);
        Value::Object(self.objects.len() - 1)
    }

    pub(super) fn object(&self, value: &Value) -> Option<&Object> {
        match value {
            Value::Object(at) => self.objects.get(*at),
            _ => None,
        }
    }

    /// The entries of a dictionary whose keys are texts.
    pub(super) fn dict(&self, value: &Value) -> Option<Named<'_>> {
        let Object::Dict(entries) = self.object(value)? else { return None };
        let named = entries.iter().filter_map(|(key, value)| match key {
            Value::Text(text) => Some((&**text, value)),
            _ => None,
        });
        Some(named.collect())
    }

    pub(super) fn list(&self, value: &Value) -> Option<&[Value]> {
        match self.object(value)? {
            Object::List(values) | Object::Tuple(values) => Some(values),
            _ => None,
        }
    }

    pub(super) fn tensor(&self, value: &Value) -> Option<&Tensor> {
        match self.object(value)? {
            Object::Tensor(tensor) => Some(tensor),
            _ => None,
        }
    }

    fn sizes(&self, value: &Value) -> Option<Vec<usize>> {
        let size = |value: &Value| match value {
            Value::Int(size) => usize::try_from(*size).ok(),
            _ => None,
        };
        self.list(value).filter(|sizes| sizes.len() <= MOST_AXES)?.iter().map(size).collect()
    }

    /// What a call gives, for the functions that are known.
    fn call(&self, function: &Value, arguments: &Value) -> Object {
        let Some(Object::Global(module, name)) = self.object(function) else { return Object::Unknown };
        let arguments = self.list(arguments).unwrap_or_default();
        match (&**module, &**name) {
            ("collections", "OrderedDict") => Object::Dict(Vec::new()),
            ("torch._utils", "_rebuild_tensor_v2") => self.tensor_of(arguments).map_or(Object::Unknown, Object::Tensor),
            // A parameter is its tensor. Nothing else is copied: a small file could name a large list many times.
            ("torch._utils", "_rebuild_parameter") => {
                let tensor = arguments.first().and_then(|data| self.tensor(data));
                tensor.map_or(Object::Unknown, |tensor| Object::Tensor(tensor.clone()))
            }
            _ => Object::Unknown,
        }
    }

    /// `(storage, offset, shape, strides, ..)`.
    fn tensor_of(&self, arguments: &[Value]) -> Option<Tensor> {
        let [storage, Value::Int(offset), shape, strides, ..] = arguments else { return None };
        let Object::Storage { dtype, entry } = self.object(storage)? else { return None };
        Some(Tensor {
            dtype: dtype.clone(),
            entry: entry.clone(),
            offset: usize::try_from(*offset).ok()?,
            shape: self.sizes(shape)?,
            strides: self.sizes(strides)?,
        })
    }

    /// `('storage', type, entry, place, size)`.
    fn storage(&self, id: &Value) -> Object {
        let Some([Value::Text(what), class, Value::Text(entry), ..]) = self.list(id) else { return Object::Unknown };
        let Some(Object::Global(_, dtype)) = self.object(class) else { return Object::Unknown };
        if &**what != "storage" {
            return Object::Unknown;
        }
        Object::Storage { dtype: dtype.clone(), entry: entry.clone() }
    }
}

/// Names that are read as data. No other is allowed.
fn known(module: &str, name: &str) -> bool {
    match module {
        "collections" => name == "OrderedDict",
        "torch._utils" => matches!(name, "_rebuild_tensor_v2" | "_rebuild_parameter"),
        "torch" => name.ends_with("Storage") && name.chars().all(|c| c.is_ascii_alphanumeric()),
        _ => false,
    }
}

struct PickleReader<'a> {
    bytes: &'a [u8],
    at: usize,
    stack: Vec<Value>,
    marks: Vec<usize>,
    memo: BTreeMap<u64, Value>,
    heap: Heap,
}

/// Reads a pickle: its value and the objects that it is made of.
///
/// # Errors
/// If it is cut short, has steps that tensors never need, or names functions other than those of tensors: the first
/// twenty of them, and how many more.
pub(super) fn read(bytes: &[u8]) -> Result<(Value, Heap), Vec<String>> {
    let (stack, marks, memo) = (Vec::new(), Vec::new(), BTreeMap::new());
    let mut reader = PickleReader { bytes, at: 0, stack, marks, memo, heap: Heap::default() };
    let value = reader.run();
    let mut problems: Vec<String> = std::mem::take(&mut reader.heap.foreign)
        .into_iter()
        .map(|name| format!("it would run `{name}`, which no tensor needs; it was not run"))
        .collect();
    if let more @ 1.. = reader.heap.all_foreign.len().saturating_sub(MOST_TOLD) {
        problems.push(format!("it would run {more} more, which no tensor needs; they were not run"));
    }
    match value {
        Ok(value) if problems.is_empty() => Ok((value, reader.heap)),
        Ok(_) => Err(problems),
        Err(problem) => {
            problems.push(problem);
            Err(problems)
        }
    }
}

impl PickleReader<'_> {
    fn take(&mut self, size: usize) -> Result<&[u8], String> {
        let end = self.at.checked_add(size).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or("the pickle is cut short; copy the file again")?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn number(&mut self, size: usize) -> Result<u64, String> {
        Ok(self.take(size)?.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
    }

    fn text(&mut self, size: usize) -> Result<String, String> {
        let size = self.number(size)?;
        let bytes = self.take(usize::try_from(size).map_err(|_| "a text of impossible length")?)?;
        String::from_utf8(bytes.to_vec()).map_err(|_| "a text that is not UTF-8".into())
    }

    fn line(&mut self) -> Result<String, String> {
        let rest = &self.bytes[self.at..];
        let size = rest.iter().position(|byte| *byte == b'\n').ok_or("the pickle is cut short; copy the file again")?;
        let line = String::from_utf8_lossy(&rest[..size]).into_owned();
        self.at += size + 1;
        Ok(line)
    }

    fn pop(&mut self) -> Result<Value, String> {
        self.stack.pop().ok_or_else(|| "a pickle that takes more than it has".into())
    }

    /// All since the last mark.
    fn marked(&mut self) -> Result<Vec<Value>, String> {
        let mark = self.marks.pop().filter(|mark| *mark <= self.stack.len());
        Ok(self.stack.split_off(mark.ok_or("a pickle without a mark where it needs one")?))
    }

    fn push(&mut self, object: Object) {
        let value = self.heap.add(object);
        self.stack.push(value);
    }

    fn tuple(&mut self, size: usize) -> Result<(), String> {
        let mut values = (0..size).map(|_| self.pop()).collect::<Result<Vec<_>, _>>()?;
        values.reverse();
        self.push(Object::Tuple(values));
        Ok(())
    }

    fn global(&mut self, module: Arc<str>, name: Arc<str>) -> Result<(), String> {
        if module.len().max(name.len()) > LONGEST_NAME {
            return Err(format!("a function whose name is longer than {LONGEST_NAME} bytes"));
        }
        if !known(&module, &name) {
            let told = format!("{module}.{name}");
            if self.heap.all_foreign.insert(told.clone()) && self.heap.foreign.len() < MOST_TOLD {
                self.heap.foreign.push(told);
            }
        }
        self.push(Object::Global(module, name));
        Ok(())
    }

    fn last(&mut self) -> Result<&mut Object, String> {
        match self.stack.last() {
            Some(Value::Object(at)) => Ok(&mut self.heap.objects[*at]),
            _ => Err("a pickle that fills what is no list".into()),
        }
    }

    fn append(&mut self, values: Vec<Value>) -> Result<(), String> {
        match self.last()? {
            Object::List(list) => list.extend(values),
            // Of a function that is not run.
            Object::Unknown => {}
            _ => return Err("a pickle that appends to what is no list".into()),
        }
        Ok(())
    }

    fn set(&mut self, values: Vec<Value>) -> Result<(), String> {
        let mut values = values.into_iter();
        match self.last()? {
            Object::Dict(entries) => {
                while let (Some(key), Some(value)) = (values.next(), values.next()) {
                    entries.push((key, value));
                }
            }
            Object::Unknown => {}
            _ => return Err("a pickle that sets what is no dictionary".into()),
        }
        Ok(())
    }

    fn remember(&mut self, key: u64) -> Result<(), String> {
        let value = self.stack.last().cloned().ok_or("a pickle that remembers nothing")?;
        self.memo.insert(key, value);
        Ok(())
    }

    fn recall(&mut self, key: u64) -> Result<(), String> {
        let value = self.memo.get(&key).cloned().ok_or("a pickle that recalls what it never had")?;
        self.stack.push(value);
        Ok(())
    }

    fn run(&mut self) -> Result<Value, String> {
        loop {
            let step = self.take(1)?[0];
            match step {
                0x80 => _ = self.take(1)?,
                0x95 => _ = self.take(8)?,
                b'.' => return self.pop(),
                b'(' => self.marks.push(self.stack.len()),
                b'0' => _ = self.pop()?,
                b'1' => _ = self.marked()?,
                b'N' => self.stack.push(Value::None),
                0x88 => self.stack.push(Value::Bool(true)),
                0x89 => self.stack.push(Value::Bool(false)),
                b'K' => self.integer(1)?,
                b'M' => self.integer(2)?,
                b'J' => {
                    let number = self.number(4)? as u32 as i32;
                    self.stack.push(Value::Int(i64::from(number)));
                }
                0x8a => {
                    let size = self.number(1)? as usize;
                    if size > 8 {
                        return Err("a number of more than 64 bits".into());
                    }
                    // The sign is that of the last byte.
                    let shift = 64 - 8 * size as u32;
                    let number = self.number(size)?;
                    self.stack.push(Value::Int(if size == 0 { 0 } else { (number << shift) as i64 >> shift }));
                }
                b'G' => {
                    let bytes: [u8; 8] = self.take(8)?.try_into().expect("eight were taken");
                    self.stack.push(Value::Float(f64::from_be_bytes(bytes)));
                }
                b'X' => self.string(4)?,
                0x8c => self.string(1)?,
                b'U' | b'C' => self.bytes_of(1)?,
                b'T' | b'B' => self.bytes_of(4)?,
                b'}' => self.push(Object::Dict(Vec::new())),
                b']' => self.push(Object::List(Vec::new())),
                b')' => self.push(Object::Tuple(Vec::new())),
                b't' => {
                    let values = self.marked()?;
                    self.push(Object::Tuple(values));
                }
                b'l' => {
                    let values = self.marked()?;
                    self.push(Object::List(values));
                }
                b'd' => {
                    let values = self.marked()?;
                    self.push(Object::Dict(Vec::new()));
                    self.set(values)?;
                }
                0x85 => self.tuple(1)?,
                0x86 => self.tuple(2)?,
                0x87 => self.tuple(3)?,
                b'a' => {
                    let value = self.pop()?;
                    self.append(vec![value])?;
                }
                b'e' => {
                    let values = self.marked()?;
                    self.append(values)?;
                }
                b's' => {
                    let (value, key) = (self.pop()?, self.pop()?);
                    self.set(vec![key, value])?;
                }
                b'u' => {
                    let values = self.marked()?;
                    self.set(values)?;
                }
                b'q' => {
                    let key = self.number(1)?;
                    self.remember(key)?;
                }
                b'r' => {
                    let key = self.number(4)?;
                    self.remember(key)?;
                }
                0x94 => {
                    let key = self.memo.len() as u64;
                    self.remember(key)?;
                }
                b'h' => {
                    let key = self.number(1)?;
                    self.recall(key)?;
                }
                b'j' => {
                    let key = self.number(4)?;
                    self.recall(key)?;
                }
                b'c' => {
                    let (module, name) = (self.line()?, self.line()?);
                    self.global(module.into(), name.into())?;
                }
                0x93 => {
                    let (name, module) = (self.pop()?, self.pop()?);
                    let (Value::Text(name), Value::Text(module)) = (name, module) else {
                        return Err("a function whose name is no text".into());
                    };
                    self.global(module, name)?;
                }
                // Calls: REDUCE, NEWOBJ. What they would make is known for tensors alone.
                b'R' | 0x81 => {
                    let (arguments, function) = (self.pop()?, self.pop()?);
                    let made = self.heap.call(&function, &arguments);
                    self.push(made);
                }
                // BUILD would set the state of an object, such as `_metadata` of a dictionary.
                b'b' => _ = self.pop()?,
                b'Q' => {
                    let id = self.pop()?;
                    let storage = self.heap.storage(&id);
                    self.push(storage);
                }
                other => return Err(format!("a step {other:#04x} at byte {} that no tensor needs", self.at - 1)),
            }
        }
    }

    fn integer(&mut self, size: usize) -> Result<(), String> {
        let number = self.number(size)?;
        self.stack.push(Value::Int(number as i64));
        Ok(())
    }

    fn string(&mut self, size: usize) -> Result<(), String> {
        let text = self.text(size)?;
        self.stack.push(Value::Text(text.into()));
        Ok(())
    }

    fn bytes_of(&mut self, size: usize) -> Result<(), String> {
        let size = self.number(size)?;
        self.take(usize::try_from(size).map_err(|_| "bytes of impossible length")?)?;
        self.push(Object::Bytes);
        Ok(())
    }
}
