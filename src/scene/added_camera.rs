//! A camera written into a copy of a scene's file. The JSON text gets a camera and a node, and otherwise stays as it
//! is, digit by digit; so do the binary chunks.

use std::collections::HashSet;
use std::fs;
use std::ops::Range;
use std::path::Path;

use glam::DVec3;
use serde_json::{Value, json};

use super::camera::{Camera, Projection};
use super::container::chunks;
use super::description::Scene;
use super::json::{self, whole};
use crate::input::read_file;
use crate::{Error, Result};

/// glTF requires a far plane of orthographic cameras. It is this many times as far as the far end of the scene, so that
/// objects may move out of what the scene is now.
const FAR: f64 = 1e3;

/// A camera in the file's world space.
#[derive(Clone, Debug, PartialEq)]
pub struct AddedCamera {
    /// Its name, to which a number is added if a camera or node has it.
    pub name: String,
    /// Position.
    pub position: DVec3,
    /// Unit axes: right, up and backward.
    pub axes: [DVec3; 3],
    /// Projection; the height of an orthographic camera in the units of the file.
    pub projection: Projection,
    /// Distance of the near plane.
    pub near: f64,
    /// Distance of the far plane; infinite for a perspective camera that has none.
    pub far: f64,
}

impl AddedCamera {
    /// A camera of the scene. `placed` has its position and axes if these are known with more digits.
    pub fn new(name: &str, scene: &Scene, camera: &Camera, placed: Option<(DVec3, [DVec3; 3])>) -> AddedCamera {
        let normalisation = &scene.normalisation;
        let scale = normalisation.scale();
        let own = || (normalisation.undo(camera.position), camera.axes.map(|axis| axis.as_dvec3()));
        let (position, axes) = placed.unwrap_or_else(own);
        let projection = match camera.projection {
            Projection::Orthographic { xmag, ymag } => {
                let size = |x: f32| (f64::from(x) / scale) as f32;
                Projection::Orthographic { xmag: size(xmag), ymag: size(ymag) }
            }
            perspective => perspective,
        };
        let (near, mut far) = (f64::from(camera.near), f64::from(camera.far));
        if matches!(projection, Projection::Orthographic { .. }) && far.is_infinite() {
            far = FAR * (1.0 + f64::from(camera.position.length()));
        }
        let [near, far] = [near, far].map(|distance| distance / scale);
        AddedCamera { name: name.to_owned(), position, axes, projection, near, far }
    }

    /// The camera's JSON. Position and axes belong to its node.
    fn json(&self, name: &str) -> Value {
        let mut value = match self.projection {
            Projection::Perspective { yfov, aspect } => {
                let mut value = json!({ "yfov": yfov, "znear": self.near });
                if let Some(aspect) = aspect {
                    value["aspectRatio"] = json!(aspect);
                }
                json!({ "type": "perspective", "perspective": value })
            }
            Projection::Orthographic { xmag, ymag } => {
                let value = json!({ "xmag": xmag, "ymag": ymag, "znear": self.near, "zfar": self.far });
                json!({ "type": "orthographic", "orthographic": value })
            }
        };
        if self.far.is_finite() && matches!(self.projection, Projection::Perspective { .. }) {
            value["perspective"]["zfar"] = json!(self.far);
        }
        value["name"] = json!(name);
        value
    }
}

/// Returns the scene's file `source` with one more camera, to be written into `folder`, and that camera's name.
///
/// # Errors
/// [`Error::Input`] for a file that cannot be read; [`Error::Usage`] if it refers to other files and `folder` is not
/// its own.
pub fn with_camera(source: &Path, folder: &Path, camera: &AddedCamera) -> Result<(Vec<u8>, String)> {
    let bytes = read_file(source).map_err(|problem| Error::input(source, "file", problem))?;
    let (text, _) = chunks(&bytes, source)?;
    let invalid = |problem: String| Error::input(source, "file", problem);
    let document = json::parse(text).map_err(&invalid)?;
    if refers_to_files(&document) && !is_same_folder(source, folder) {
        let shown = source.display();
        let problem =
            format!("{shown}: its buffers, textures or functions are in other files, so a copy must be beside it");
        return Err(Error::Usage(problem));
    }
    let text = std::str::from_utf8(text).map_err(|problem| invalid(problem.to_string()))?;
    let name = free_name(&document, &camera.name);
    let edited =
        edit(text, &document, camera, &name).ok_or_else(|| invalid("the file is not a glTF document".to_owned()))?;
    let is_binary = bytes.starts_with(b"glTF");
    Ok((if is_binary { binary(&bytes, edited) } else { edited.into_bytes() }, name))
}

/// Whether a buffer, an image or a procedural object has a URI other than a data URI.
fn refers_to_files(document: &Value) -> bool {
    let entries = |list: &str| document[list].as_array().into_iter().flatten();
    let uris = entries("buffers").chain(entries("images")).map(|entry| &entry["uri"]);
    let objects = entries("nodes").map(|node| &node["extensions"]["PENUMBRA_procedural"]);
    let functions = objects.flat_map(|object| [&object["source"], &object["colour"]["source"]]);
    uris.chain(functions).filter_map(Value::as_str).any(|uri| !uri.starts_with("data:"))
}

fn is_same_folder(file: &Path, folder: &Path) -> bool {
    // An empty path is the current folder.
    let here = |folder: &Path| fs::canonicalize(Path::new(".").join(folder)).ok();
    let own = here(file.parent().unwrap_or(Path::new("")));
    own.is_some() && own == here(folder)
}

/// The name, with a number if a camera or a node has it.
fn free_name(document: &Value, name: &str) -> String {
    let of = |list: &str| document[list].as_array().into_iter().flatten().filter_map(|entry| entry["name"].as_str());
    let taken: HashSet<&str> = of("cameras").chain(of("nodes")).collect();
    let numbered = (2..).map(|number| format!("{name} {number}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    names.find(|name| !taken.contains(name.as_str())).unwrap_or_default()
}

/// The text with a camera and its node; `None` if it is not a glTF document.
fn edit(text: &str, document: &Value, camera: &AddedCamera, name: &str) -> Option<String> {
    let length = |list: &str| document[list].as_array().map_or(0, Vec::len);
    let [right, up, backward] = camera.axes;
    let columns = [right.extend(0.0), up.extend(0.0), backward.extend(0.0), camera.position.extend(1.0)];
    let matrix: Vec<f64> = columns.iter().flat_map(|column| column.to_array()).collect();
    let node = json!({ "name": name, "camera": length("cameras"), "matrix": matrix });
    let scene = whole(&document["scene"]).unwrap_or(0);
    let mut text = append(text, &["cameras"], &camera.json(name).to_string())?;
    text = append(&text, &["nodes"], &node.to_string())?;
    // Without scenes all roots are shown.
    if length("scenes") > 0 {
        text = append(&text, &["scenes", &scene.to_string(), "nodes"], &length("nodes").to_string())?;
    }
    Some(text)
}

/// The text with `entry` added at the end of the array at `path`. The array is made if its holder lacks it.
fn append(text: &str, path: &[&str], entry: &str) -> Option<String> {
    let (last, holders) = path.split_last()?;
    let mut at = text.find('{')?;
    for step in holders {
        at = member(text, at, step)?.start;
    }
    let (index, inserted) = match member(text, at, last) {
        Some(array) => {
            let is_empty = text[array.start + 1..array.end - 1].trim().is_empty();
            (array.end - 1, if is_empty { entry.to_owned() } else { format!(",{entry}") })
        }
        None => {
            let is_empty = text[at + 1..].trim_start().starts_with('}');
            let comma = if is_empty { "" } else { "," };
            (at + 1, format!("\"{last}\":[{entry}]{comma}"))
        }
    };
    Some([&text[..index], &inserted, &text[index..]].concat())
}

/// Range of the value of a member in the object that begins at `at`, or of an entry in an array, by its index. The text
/// must be valid JSON.
fn member(text: &str, at: usize, wanted: &str) -> Option<Range<usize>> {
    let bytes = text.as_bytes();
    let is_object = bytes.get(at) == Some(&b'{');
    let mut index = 0usize;
    let mut next = skip_blanks(bytes, at + 1);
    while !matches!(bytes.get(next)?, b'}' | b']') {
        let mut key = index.to_string();
        if is_object {
            let end = skip_value(bytes, next)?;
            key = serde_json::from_str(&text[next..end]).ok()?;
            // Past the colon.
            next = skip_blanks(bytes, skip_blanks(bytes, end) + 1);
        }
        let end = skip_value(bytes, next)?;
        if key == wanted {
            return Some(next..end);
        }
        next = skip_blanks(bytes, end);
        if bytes.get(next) == Some(&b',') {
            next = skip_blanks(bytes, next + 1);
        }
        index += 1;
    }
    None
}

fn skip_blanks(bytes: &[u8], at: usize) -> usize {
    at + bytes[at.min(bytes.len())..].iter().take_while(|byte| byte.is_ascii_whitespace()).count()
}

/// The end of the value that begins at `at`.
fn skip_value(bytes: &[u8], at: usize) -> Option<usize> {
    let (mut depth, mut in_string, mut is_escaped) = (0usize, false, false);
    for (index, byte) in bytes.iter().enumerate().skip(at) {
        match byte {
            _ if is_escaped => is_escaped = false,
            b'\\' if in_string => is_escaped = true,
            b'"' => in_string = !in_string,
            _ if in_string => {}
            b'{' | b'[' => depth += 1,
            // The end of the holder, after a number or a word.
            b'}' | b']' | b',' if depth == 0 => return Some(index),
            b'}' | b']' => depth -= 1,
            byte if depth == 0 && byte.is_ascii_whitespace() => return Some(index),
            _ => {}
        }
        if depth == 0 && !in_string && matches!(byte, b'"' | b'}' | b']') {
            return Some(index + 1);
        }
    }
    None
}

/// A binary file with another JSON chunk, which comes first.
fn binary(bytes: &[u8], json: String) -> Vec<u8> {
    const HEADER: usize = 12;
    let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
    let (length, rest) = (word(8).min(bytes.len()), HEADER + 8 + word(HEADER));
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let after = bytes.get(rest..length).unwrap_or_default();
    let total = (HEADER + 8 + json.len() + after.len()) as u32;
    let mut file = bytes[..8].to_vec();
    file.extend(total.to_le_bytes());
    file.extend((json.len() as u32).to_le_bytes());
    file.extend(b"JSON");
    file.extend(json);
    file.extend(after);
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_appended_and_the_rest_stays() {
        let text = r#"  { "a" : {"nodes":[9]}, "n\u006fdes" : [ 1.50, "]\"" ] , "scenes":[{},{ "name":"x" }] }"#;
        let once = append(text, &["nodes"], "7").unwrap();
        assert_eq!(once, text.replace(r#""]\"" ]"#, r#""]\"" ,7]"#));
        let twice = append(&once, &["scenes", "0", "nodes"], "3").unwrap();
        assert_eq!(twice, once.replace("[{},", r#"[{"nodes":[3]},"#));
        let thrice = append(&twice, &["scenes", "1", "nodes"], "3").unwrap();
        assert_eq!(thrice, twice.replace(r#"{ "name""#, r#"{"nodes":[3], "name""#));
        assert_eq!(append(&thrice, &["cameras"], "{}").unwrap(), thrice.replacen('{', r#"{"cameras":[{}],"#, 1));
        assert_eq!(append(&thrice, &["scenes", "2", "nodes"], "3"), None);
        assert_eq!(append("{\"a\":[ ]}", &["a"], "1").unwrap(), "{\"a\":[ 1]}");
    }

    #[test]
    fn a_name_that_is_taken_gets_a_number() {
        let document = json!({ "cameras": [{ "name": "view" }], "nodes": [{ "name": "view 2" }, {}] });
        assert_eq!(free_name(&document, "view"), "view 3");
        assert_eq!(free_name(&document, "other"), "other");
    }

    #[test]
    fn files_of_their_own_are_noticed() {
        let uri = |uri: &str| json!({ "buffers": [{ "byteLength": 1 }], "images": [{ "uri": uri }] });
        assert!(refers_to_files(&uri("a.png")) && !refers_to_files(&uri("data:image/png;base64,AA")));
        let object =
            |uri: &str| json!({ "nodes": [{}, { "extensions": { "PENUMBRA_procedural": { "source": uri } } }] });
        assert!(refers_to_files(&object("a.wgsl")) && !refers_to_files(&object("data:,fn%20f")));
    }
}
