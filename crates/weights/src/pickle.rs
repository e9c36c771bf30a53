//! The subset of Python's pickle format that describes tensors.
//!
//! A pickle is a program for a stack machine. Python's machine calls any function that the program names; this one has only
//! the instructions for descriptions of tensors, builds plain values, and calls nothing.

use super::stored::{FloatType, StoredTensor};
use std::collections::BTreeMap;
use std::rc::Rc;

/// Largest nesting depth of containers.
const MAX_DEPTH: usize = 16;

/// A value, or a description of the damage.
type Parsed<T> = Result<T, String>;

/// A value on the stack.
#[derive(Clone, Debug)]
pub(super) enum Value {
    /// A number, a boolean, or `None`, which are not distinguished until it matters.
    Number(i64),
    Text(Rc<str>),
    /// A class or a function of Python.
    Name(Rc<str>),
    Tuple(Rc<[Value]>),
    /// A dictionary: keys and values.
    Dict(Vec<(Value, Value)>),
    /// A part of the file that contains numbers.
    Storage(Rc<str>, Option<FloatType>),
    Tensor(Rc<StoredTensor>),
    /// Any value that tensors do not depend on.
    Other,
}

/// Runs a program; an error describes what is wrong with it.
pub(super) fn run(program: &[u8]) -> Parsed<Value> {
    Machine {
        program,
        stack: Vec::new(),
        marks: Vec::new(),
        memo: BTreeMap::new(),
    }
    .run()
}

struct Machine<'a> {
    /// Remaining instructions.
    program: &'a [u8],
    /// Values, with their nesting depths.
    stack: Vec<(Value, usize)>,
    marks: Vec<usize>,
    memo: BTreeMap<u32, (Value, usize)>,
}

impl Machine<'_> {
    fn run(mut self) -> Parsed<Value> {
        loop {
            let [code] = self.take()?;
            match code {
                // PROTO
                0x80 => {
                    let [version] = self.take()?;
                    if version > 4 {
                        return Err(format!("is described in version {version} of pickle"));
                    }
                }
                // FRAME
                0x95 => drop(self.take::<8>()?),
                b'}' => self.push(Value::Dict(Vec::new()), 1)?,
                b']' | b'N' => self.push(Value::Other, 1)?,
                b')' => self.push(Value::Tuple([].into()), 1)?,
                0x88 => self.push(Value::Number(1), 1)?,
                0x89 => self.push(Value::Number(0), 1)?,
                b'K' => {
                    let [value] = self.take()?;
                    self.push(Value::Number(value.into()), 1)?;
                }
                b'M' => {
                    let value = u16::from_le_bytes(self.take()?);
                    self.push(Value::Number(value.into()), 1)?;
                }
                b'J' => {
                    let value = i32::from_le_bytes(self.take()?);
                    self.push(Value::Number(value.into()), 1)?;
                }
                // LONG1
                0x8a => {
                    let [length] = self.take()?;
                    let value = decode_long(self.bytes(length.into())?)?;
                    self.push(Value::Number(value), 1)?;
                }
                // BINFLOAT
                b'G' => {
                    self.take::<8>()?;
                    self.push(Value::Other, 1)?;
                }
                b'X' => {
                    let length = u32::from_le_bytes(self.take()?);
                    self.text(length as usize)?;
                }
                // SHORT_BINUNICODE
                0x8c => {
                    let [length] = self.take()?;
                    self.text(length.into())?;
                }
                b'c' => {
                    let (module, name) = (self.line()?, self.line()?);
                    self.push(Value::Name(format!("{module}.{name}").into()), 1)?;
                }
                // STACK_GLOBAL
                0x93 => match (self.pop()?.0, self.pop()?.0) {
                    (Value::Text(name), Value::Text(module)) => {
                        self.push(Value::Name(format!("{module}.{name}").into()), 1)?;
                    }
                    _ => return Err("names a class by something else than texts".into()),
                },
                b'(' => self.marks.push(self.stack.len()),
                b't' => {
                    let values = self.pop_to_mark()?;
                    self.tuple(values)?;
                }
                0x85..=0x87 => {
                    let count = usize::from(code - 0x84);
                    let from = self
                        .stack
                        .len()
                        .checked_sub(count)
                        .ok_or_else(stack_underflow)?;
                    let values = self.stack.split_off(from);
                    self.tuple(values)?;
                }
                b'q' => {
                    let [index] = self.take()?;
                    self.memoize(index.into())?;
                }
                b'r' => {
                    let index = u32::from_le_bytes(self.take()?);
                    self.memoize(index)?;
                }
                // MEMOIZE
                0x94 => self.memoize(self.memo.len() as u32)?,
                b'h' => {
                    let [index] = self.take()?;
                    self.get_memo(index.into())?;
                }
                b'j' => {
                    let index = u32::from_le_bytes(self.take()?);
                    self.get_memo(index)?;
                }
                b'Q' => {
                    let storage = storage(&self.pop()?.0)?;
                    self.push(storage, 1)?;
                }
                b'R' => {
                    let (arguments, name) = (self.pop()?.0, self.pop()?.0);
                    self.push(call(&name, &arguments)?, 1)?;
                }
                b's' => {
                    let (value, key) = (self.pop()?, self.pop()?);
                    self.add(vec![key, value])?;
                }
                b'u' => {
                    let entries = self.pop_to_mark()?;
                    self.add(entries)?;
                }
                b'e' => drop(self.pop_to_mark()?),
                // A value of a list, which is ignored, or attributes of a dictionary.
                b'a' | b'b' => drop(self.pop()?),
                b'.' => return Ok(self.pop()?.0),
                code => {
                    return Err(format!(
                        "is described with the instruction {code:#04x}, which tensors do not need"
                    ));
                }
            }
        }
    }

    fn bytes(&mut self, count: usize) -> Parsed<&[u8]> {
        let (taken, rest) = self
            .program
            .split_at_checked(count)
            .ok_or("is described by a program that ends early")?;
        self.program = rest;
        Ok(taken)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let bytes = self.bytes(N)?;
        Ok(std::array::from_fn(|i| bytes[i]))
    }

    fn line(&mut self) -> Parsed<String> {
        let end = self.program.iter().position(|byte| *byte == b'\n');
        let end = end.ok_or("is described by a program that ends early")?;
        let text = String::from_utf8_lossy(self.bytes(end)?).into_owned();
        self.bytes(1)?;
        Ok(text)
    }

    fn text(&mut self, length: usize) -> Parsed<()> {
        let text: Rc<str> = String::from_utf8_lossy(self.bytes(length)?).into();
        self.push(Value::Text(text), 1)
    }

    fn push(&mut self, value: Value, depth: usize) -> Parsed<()> {
        if depth > MAX_DEPTH {
            return Err(format!("nests values more than {MAX_DEPTH} deep"));
        }
        self.stack.push((value, depth));
        Ok(())
    }

    fn pop(&mut self) -> Parsed<(Value, usize)> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= bottom {
            return Err(stack_underflow());
        }
        self.stack.pop().ok_or_else(stack_underflow)
    }

    /// Removes all values since the last mark.
    fn pop_to_mark(&mut self) -> Parsed<Vec<(Value, usize)>> {
        let mark = self.marks.pop().ok_or_else(stack_underflow)?;
        if mark > self.stack.len() {
            return Err(stack_underflow());
        }
        Ok(self.stack.split_off(mark))
    }

    fn tuple(&mut self, values: Vec<(Value, usize)>) -> Parsed<()> {
        let depth = values.iter().map(|(_, depth)| *depth).max().unwrap_or(0);
        let values: Vec<Value> = values.into_iter().map(|(value, _)| value).collect();
        self.push(Value::Tuple(values.into()), depth + 1)
    }

    /// Adds alternating keys and values to the dictionary on top.
    fn add(&mut self, entries: Vec<(Value, usize)>) -> Parsed<()> {
        let (Value::Dict(names), depth) = self.stack.last_mut().ok_or_else(stack_underflow)? else {
            return Err("sets entries of something else than a dictionary".into());
        };
        let mut entries = entries.into_iter();
        while let (Some((key, _)), Some((value, inner))) = (entries.next(), entries.next()) {
            *depth = (*depth).max(inner + 1);
            names.push((key, value));
        }
        if *depth > MAX_DEPTH {
            return Err(format!("nests values more than {MAX_DEPTH} deep"));
        }
        Ok(())
    }

    fn memoize(&mut self, index: u32) -> Parsed<()> {
        let (value, depth) = self.stack.last().ok_or_else(stack_underflow)?;
        let value = match value {
            // It is filled afterwards, so that a recalled copy would differ.
            Value::Dict(_) => Value::Other,
            value => value.clone(),
        };
        self.memo.insert(index, (value, *depth));
        Ok(())
    }

    fn get_memo(&mut self, index: u32) -> Parsed<()> {
        let found = self.memo.get(&index).cloned();
        let (value, depth) = found.ok_or("recalls what was not stored")?;
        self.push(value, depth)
    }
}

fn stack_underflow() -> String {
    "takes more values than there are".into()
}

/// Decodes a little-endian number of any length.
fn decode_long(bytes: &[u8]) -> Parsed<i64> {
    if bytes.len() > 8 {
        return Err("has a number of more than 64 bits".into());
    }
    let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
    let mut all = [if negative { 0xff } else { 0 }; 8];
    all[..bytes.len()].copy_from_slice(bytes);
    Ok(i64::from_le_bytes(all))
}

/// Resolves `("storage", class, key, device, count)`.
fn storage(value: &Value) -> Parsed<Value> {
    match value {
        Value::Tuple(parts) => match &parts[..] {
            [_, Value::Name(class), Value::Text(key), ..] => {
                let kind = class.strip_prefix("torch.").and_then(FloatType::of_storage);
                Ok(Value::Storage(key.clone(), kind))
            }
            _ => Err("refers to something else than a storage".into()),
        },
        _ => Err("refers to something else than a storage".into()),
    }
}

/// Returns the result of a Python function, for the few that tensors need.
fn call(name: &Value, arguments: &Value) -> Parsed<Value> {
    let (Value::Name(name), Value::Tuple(arguments)) = (name, arguments) else {
        return Err("calls something else than a named function".into());
    };
    match (&**name, &arguments[..]) {
        ("collections.OrderedDict", _) => Ok(Value::Dict(Vec::new())),
        ("torch._utils._rebuild_parameter", [tensor @ Value::Tensor(_), ..]) => Ok(tensor.clone()),
        (
            "torch._utils._rebuild_tensor_v2",
            [
                Value::Storage(key, kind),
                Value::Number(offset),
                shape,
                stride,
                ..,
            ],
        ) => {
            let stored = StoredTensor {
                storage: key.clone(),
                kind: *kind,
                offset: usize::try_from(*offset).map_err(|_| "has a negative offset")?,
                shape: sides(shape)?,
                stride: sides(stride)?,
            };
            if stored.shape.len() != stored.stride.len() {
                return Err("has a tensor of other strides than axes".into());
            }
            Ok(Value::Tensor(Rc::new(stored)))
        }
        _ => Err(format!("calls `{name}`, which tensors do not need")),
    }
}

fn sides(value: &Value) -> Parsed<Vec<usize>> {
    let wrong = || "has a tensor without a shape".to_owned();
    let Value::Tuple(values) = value else {
        return Err(wrong());
    };
    let side = |value: &Value| match value {
        Value::Number(side) => usize::try_from(*side).map_err(|_| wrong()),
        _ => Err(wrong()),
    };
    values.iter().map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pytorch::collect;
    use proptest::prelude::*;

    #[test]
    fn programs_that_call_something_are_refused() {
        // The pickle of `os.system("true")`.
        let error = run(b"\x80\x02cos\nsystem\nX\x04\x00\x00\x00true\x85R.").unwrap_err();
        assert!(error.contains("os.system"), "{error}");
        let error = run(b"\x80\x02cbuiltins\neval\nX\x01\x00\x00\x001\x85R.").unwrap_err();
        assert!(error.contains("builtins.eval"), "{error}");
    }

    #[test]
    fn programs_without_sense_are_refused() {
        for program in [
            &b""[..],
            b".",
            b"\x80\x05.",
            b"\x85.",
            b"(}t",
            b"h\x01.",
            b"K\x01K\x02s.",
            b"\x8a\x09123456789.",
            b"K\x01Q.",
            b"X\xff\xff\xff\xffabc",
            b"i.",
        ] {
            assert!(run(program).is_err(), "{program:?}");
        }
        // Dropping deep nesting would overflow the stack.
        let mut deep = vec![b')'];
        deep.extend(std::iter::repeat_n(0x85, 100_000));
        deep.push(b'.');
        assert!(run(&deep).unwrap_err().contains("deep"));
    }

    #[test]
    fn long_numbers_have_a_sign() {
        assert_eq!(decode_long(&[]), Ok(0));
        assert_eq!(decode_long(&[0xff]), Ok(-1));
        assert_eq!(decode_long(&[0x00, 0x80]), Ok(-32_768));
        assert_eq!(decode_long(&[0xff, 0x00]), Ok(255));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..ProptestConfig::default() })]

        /// Instructions in any order, and bytes between them.
        #[test]
        fn no_program_breaks_the_machine(
            codes in prop::collection::vec(
                prop::sample::select(b"}])NKMJX(ct\x85\x86\x87qrhjQRsuaeb\x88\x8a\x93\x94G\x00\x01\x02\n.".to_vec()),
                0..60,
            ),
        ) {
            if let Ok(value) = run(&codes) {
                collect(value, &mut Vec::new());
            }
        }
    }
}
