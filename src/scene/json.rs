//! JSON values with their JSON pointers, so that every error can state its location in the document.

use std::path::Path;

use serde_json::Value;

use crate::input::printable;
use crate::{Error, Result};

/// Maximum number of values and members of a document. A scene of a million nodes has fewer, and each takes at most 600
/// bytes of memory.
const MAX_VALUES: usize = 1 << 23;

/// Parses a document. The error is one line.
pub(super) fn parse(text: &[u8]) -> std::result::Result<Value, String> {
    if text.starts_with(b"\xef\xbb\xbf") {
        return Err("begins with a byte order mark, which glTF forbids: save it as UTF-8 without one".into());
    }
    if !text.trim_ascii_start().starts_with(b"{") {
        return Err("not glTF: JSON in UTF-8 is expected, which begins with {".into());
    }
    if values(text) > MAX_VALUES {
        return Err(format!("has more than {MAX_VALUES} JSON values"));
    }
    serde_json::from_slice(text).map_err(|problem| format!("invalid JSON: {problem}"))
}

/// An upper bound on the number of values and members of a document: each follows a bracket, a comma or a colon.
fn values(text: &[u8]) -> usize {
    let (mut count, mut in_string, mut escaped) = (1, false, false);
    for byte in text {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = in_string,
            b'"' => in_string = !in_string,
            b'[' | b'{' | b',' | b':' => count += usize::from(!in_string),
            _ => {}
        }
    }
    count
}

/// A JSON value, with its pointer and file.
#[derive(Clone)]
pub(super) struct Json<'a> {
    value: &'a Value,
    pointer: String,
    file: &'a Path,
}

impl<'a> Json<'a> {
    /// The root of a document.
    pub fn root(value: &'a Value, file: &'a Path) -> Self {
        Json { value, pointer: String::new(), file }
    }

    /// The value itself.
    pub fn value(&self) -> &'a Value {
        self.value
    }

    /// The file of the document.
    pub fn file(&self) -> &'a Path {
        self.file
    }

    /// An [`Error::Input`] at the location of this value.
    pub fn error(&self, problem: impl std::fmt::Display) -> Error {
        let pointer = if self.pointer.is_empty() { "/" } else { &self.pointer };
        Error::input(self.file, pointer, problem)
    }

    fn at(&self, value: &'a Value, key: impl std::fmt::Display) -> Self {
        Json { value, pointer: format!("{}/{key}", self.pointer), file: self.file }
    }

    fn mismatch(&self, expected: &str) -> Error {
        self.error(format!("not {expected}"))
    }

    /// The member `key`, if present.
    pub fn get(&self, key: &str) -> Result<Option<Self>> {
        let members = self.value.as_object().ok_or_else(|| self.mismatch("an object"))?;
        // RFC 6901 section 3.
        Ok(members.get(key).map(|value| self.at(value, key.replace('~', "~0").replace('/', "~1"))))
    }

    /// The member `key`, which must be present.
    pub fn require(&self, key: &str) -> Result<Self> {
        self.get(key)?.ok_or_else(|| self.error(format!("`{key}` is missing")))
    }

    /// The payload of the extension `name`, if present.
    pub fn extension(&self, name: &str) -> Result<Option<Self>> {
        self.get("extensions")?.map_or(Ok(None), |extensions| extensions.get(name))
    }

    /// The elements of an array.
    pub fn items(&self) -> Result<Vec<Self>> {
        let items = self.value.as_array().ok_or_else(|| self.mismatch("an array"))?;
        Ok(items.iter().enumerate().map(|(i, value)| self.at(value, i)).collect())
    }

    /// The elements of the array `key`. Empty if the member is absent.
    pub fn list(&self, key: &str) -> Result<Vec<Self>> {
        self.get(key)?.map_or(Ok(Vec::new()), |list| list.items())
    }

    /// The number of elements of the array `key`. 0 if the member is absent.
    pub fn list_len(&self, key: &str) -> Result<usize> {
        Ok(self.get(key)?.map_or(0, |list| list.len()))
    }

    /// The members of an object, by their keys.
    pub fn members(&self) -> Result<Vec<(&'a str, Self)>> {
        let members = self.value.as_object().ok_or_else(|| self.mismatch("an object"))?;
        members.keys().map(|key| Ok((key.as_str(), self.require(key)?))).collect()
    }

    /// The number of elements or members of an array or object, 0 for other values.
    pub fn len(&self) -> usize {
        self.value.as_array().map(Vec::len).or_else(|| self.value.as_object().map(|m| m.len())).unwrap_or(0)
    }

    /// The value as a string.
    pub fn string(&self) -> Result<&'a str> {
        self.value.as_str().ok_or_else(|| self.mismatch("a string"))
    }

    /// The value as a boolean.
    pub fn boolean(&self) -> Result<bool> {
        self.value.as_bool().ok_or_else(|| self.mismatch("a boolean"))
    }

    /// The value as a number.
    pub fn number(&self) -> Result<f64> {
        self.value.as_f64().ok_or_else(|| self.mismatch("a number"))
    }

    /// The value as a whole number of at least 0. As in JSON Schema, a float without a fraction is a whole number.
    pub fn whole(&self) -> Result<usize> {
        whole(self.value).ok_or_else(|| self.mismatch("a whole number, 0 or more"))
    }

    /// The value as an index into a list of `count` elements. `what` names the element in the error.
    pub fn index(&self, count: usize, what: &str) -> Result<usize> {
        let index = self.whole()?;
        if index < count { Ok(index) } else { Err(self.error(format!("{what} {index} of {count} does not exist"))) }
    }

    /// The value as an array of exactly `N` numbers.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N]> {
        let items = self.items()?;
        if items.len() != N {
            return Err(self.error(format!("has {} numbers, not {N}", items.len())));
        }
        let mut numbers = [0.0; N];
        for (number, item) in numbers.iter_mut().zip(items) {
            *number = item.number()?;
        }
        Ok(numbers)
    }

    /// The number `key`, or `default` if it is absent. It must be in `range` and finite as an f32.
    pub fn number_in(&self, key: &str, default: f64, range: impl std::ops::RangeBounds<f64>) -> Result<f32> {
        let Some(member) = self.get(key)? else { return Ok(default as f32) };
        let number = member.number()?;
        if range.contains(&number) && (number as f32).is_finite() {
            Ok(number as f32)
        } else {
            Err(member.error(format!("{number} is out of range")))
        }
    }

    /// The `N` numbers of `key`, or `default` for each if it is absent. Each must be in `range` and finite as an f32.
    pub fn numbers_in<const N: usize>(
        &self,
        key: &str,
        default: f64,
        range: impl std::ops::RangeBounds<f64>,
    ) -> Result<[f32; N]> {
        let Some(member) = self.get(key)? else { return Ok([default as f32; N]) };
        let numbers = member.numbers::<N>()?;
        match numbers.iter().find(|&x| !range.contains(x) || !(*x as f32).is_finite()) {
            Some(x) => Err(member.error(format!("{x} is out of range"))),
            None => Ok(numbers.map(|x| x as f32)),
        }
    }

    /// The name of this object, if it has one. It is shortened, because many objects may copy it.
    pub fn name(&self) -> Result<Option<String>> {
        self.get("name")?.map(|name| name.string().map(printable)).transpose()
    }
}

/// See [`Json::whole`].
pub(super) fn whole(value: &Value) -> Option<usize> {
    let from_float = || value.as_f64().filter(|x| x.fract() == 0.0 && (0.0..9e15).contains(x)).map(|x| x as u64);
    value.as_u64().or_else(from_float).and_then(|x| usize::try_from(x).ok())
}
