//! Animations, and the document in the pose of a moment.
//!
//! Every animation is checked, whether it is played or not. The values at a moment replace those in the document, which
//! import then reads as any other: transforms, weights of morph targets, cameras, lights, materials, and which nodes
//! are shown.

use std::collections::HashMap;

use serde_json::Value;

use super::accessor::Accessor;
use super::import_options::ImportOptions;
use super::json::Json;
use super::keyframes::{Reader, Sampler};
use super::notes::Notes;
use super::pointer::Property;
use super::selection::select;
use crate::{Error, Result};

/// Name of the extension by which channels animate any property.
pub(super) const POINTER_EXTENSION: &str = "KHR_animation_pointer";

/// An animation of the file.
struct Animation<'r, 'a> {
    name: Option<String>,
    channels: Vec<Channel<'r, 'a>>,
}

/// The effect of an animation on one property.
struct Channel<'r, 'a> {
    json: Json<'a>,
    target: Target,
    sampler: Sampler<'r, 'a>,
}

enum Target {
    Property(Property),
    /// The pointer or path of a property that import does not support.
    Unknown(String),
}

/// The result of a document's animations.
pub(super) struct Posed {
    /// The document at a moment; `None` for the pose of the file.
    pub document: Option<Value>,
    /// Time of the last key of the animation that is or would be played, in seconds; `None` without animations.
    pub end: Option<f64>,
}

/// Checks the animations of a document, and makes its pose at the time that `options` request.
pub(super) fn pose(root: &Json, accessors: &[Accessor], options: &ImportOptions, notes: &mut Notes) -> Result<Posed> {
    let animations = read(root, accessors)?;
    let Some(seconds) = options.time else {
        if !animations.is_empty() {
            let are = match animations.len() {
                1 => "the animation is".to_owned(),
                count => format!("{count} animations are"),
            };
            notes.push(format!("{are} not played: without `time` the scene has the pose of the file"));
        }
        // Which animation is wanted matters only where one is played.
        let found = find(&animations, options).ok().flatten();
        let end = found.map(Animation::end).transpose()?;
        return Ok(Posed { document: None, end });
    };
    if !seconds.is_finite() {
        return Err(Error::setting("time", "must be finite"));
    }
    let no_animation = || Error::setting("time", "has no meaning: the scene has no animation");
    let animation = find(&animations, options)?.ok_or_else(no_animation)?;
    let end = animation.end()?;
    let seconds = if options.repeat && end > 0.0 { seconds.rem_euclid(end) } else { seconds };
    let mut document = root.value().clone();
    for Channel { json, target, sampler } in &animation.channels {
        let property = match target {
            Target::Property(property) => property,
            Target::Unknown(name) => {
                notes.push(format!("the animation of \"{name}\" is not played: the property is not known"));
                continue;
            }
        };
        let numbers = sampler.at(seconds, property.values)?;
        if numbers.iter().any(|x| !x.is_finite()) {
            return Err(json.error(format!("has a value that is not finite at {seconds} s")));
        }
        property.set(&mut document, &numbers);
    }
    Ok(Posed { document: Some(document), end: Some(end) })
}

impl Animation<'_, '_> {
    /// Time of its last key.
    fn end(&self) -> Result<f64> {
        self.channels.iter().try_fold(0.0f64, |end, channel| Ok(end.max(channel.sampler.end()?)))
    }
}

/// The animation of the options, or the first one; `None` if there is no animation.
fn find<'s, 'r, 'a>(
    animations: &'s [Animation<'r, 'a>],
    options: &ImportOptions,
) -> Result<Option<&'s Animation<'r, 'a>>> {
    match &options.animation {
        Some(wanted) if !animations.is_empty() => {
            select("animation", wanted, animations, |animation| animation.name.as_deref()).map(Some)
        }
        _ => Ok(animations.first()),
    }
}

fn read<'r, 'a>(root: &Json<'a>, accessors: &'r [Accessor<'a>]) -> Result<Vec<Animation<'r, 'a>>> {
    let mut reader = Reader::new(accessors);
    let list = root.list("animations")?;
    list.iter().map(|json| animation(root, json, &mut reader)).collect()
}

fn animation<'r, 'a>(root: &Json<'a>, json: &Json<'a>, reader: &mut Reader<'r, 'a>) -> Result<Animation<'r, 'a>> {
    let not_empty = |key: &str| -> Result<Vec<Json<'a>>> {
        let list = json.require(key)?;
        let items = list.items()?;
        if items.is_empty() { Err(list.error("must not be empty")) } else { Ok(items) }
    };
    let (listed, samplers) = (not_empty("channels")?, not_empty("samplers")?);
    let samplers = samplers.iter().map(|sampler| reader.sampler(sampler)).collect::<Result<Vec<_>>>()?;
    let mut channels = Vec::new();
    let mut targets = HashMap::new();
    for (i, json) in listed.iter().enumerate() {
        let sampler_json = json.require("sampler")?;
        let sampler = samplers[sampler_json.index(samplers.len(), "sampler")?];
        let target_json = json.require("target")?;
        let Some(Stated { pointer, at, extended }) = stated(root, &target_json)? else { continue };
        if let Some(first) = targets.insert(pointer.clone(), i) {
            return Err(listed[first].require("target")?.error(format!("channel {i} has the same target")));
        }
        let target = match Property::find(root.value(), &pointer).map_err(|problem| at.error(problem))? {
            Some(property) => {
                reader.check(&sampler_json, &sampler, property.values, extended)?;
                Target::Property(property)
            }
            None => Target::Unknown(pointer),
        };
        channels.push(Channel { json: json.clone(), target, sampler });
    }
    Ok(Animation { name: json.name()?, channels })
}

/// The target of a channel as the file states it.
struct Stated<'a> {
    /// JSON pointer of the property.
    pointer: String,
    /// The value that states it.
    at: Json<'a>,
    /// It is stated by KHR_animation_pointer.
    extended: bool,
}

/// The target of a channel. `None` if no node is stated, which glTF ignores.
fn stated<'a>(root: &Json<'a>, target: &Json<'a>) -> Result<Option<Stated<'a>>> {
    let path = target.require("path")?.string()?;
    if path == "pointer" {
        let extension = target.extension(POINTER_EXTENSION)?;
        let extension = extension.ok_or_else(|| target.error(format!("has no {POINTER_EXTENSION}")))?;
        let at = extension.require("pointer")?;
        return Ok(Some(Stated { pointer: at.string()?.to_owned(), at, extended: true }));
    }
    let Some(node) = target.get("node")? else { return Ok(None) };
    let index = node.index(root.list_len("nodes")?, "node")?;
    Ok(Some(Stated { pointer: format!("/nodes/{index}/{path}"), at: target.clone(), extended: false }))
}
