//! Composition of the functions of a scene into one WGSL module.

use std::fmt::Write;
use std::sync::{Arc, LazyLock};

use super::check::File;
use super::role::Role;

/// The functions of a scene's procedural objects, in the form in which kernels are composed with them.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Functions {
    /// WESL source of the module `package::lib::procedural_functions`.
    pub(crate) wesl: Arc<str>,
}

impl Default for Functions {
    /// A module without functions.
    fn default() -> Self {
        static NONE: LazyLock<Functions> =
            LazyLock::new(|| Builder::default().finish().expect("an empty module can be written"));
        NONE.clone()
    }
}

/// Collects the functions of a scene from WGSL files.
#[derive(Default)]
pub struct Builder {
    files: Vec<File>,
    surfaces: Vec<Role>,
    colours: u32,
    used: Vec<UsedFunction>,
}

/// A function that an object uses.
struct UsedFunction {
    file: usize,
    name: String,
    role: Role,
    number: u32,
}

impl Builder {
    /// Adds the function `name` of a WGSL file with the text `source`. Returns its number among the colour functions or
    /// among the other functions.
    ///
    /// # Errors
    /// One line that describes the problem of the file or the function.
    pub fn function(&mut self, source: &str, name: &str, role: Role) -> std::result::Result<u32, String> {
        let file = match self.files.iter().position(|file| file.source == source) {
            Some(file) => file,
            None => {
                self.files.push(File::read(source)?);
                self.files.len() - 1
            }
        };
        self.files[file].check(name, role)?;
        let mut used = self.used.iter();
        if let Some(used) = used.find(|used| (used.file, used.name.as_str(), used.role) == (file, name, role)) {
            return Ok(used.number);
        }
        let number = if role == Role::Colour {
            self.colours += 1;
            self.colours - 1
        } else {
            self.surfaces.push(role);
            self.surfaces.len() as u32 - 1
        };
        self.used.push(UsedFunction { file, name: name.to_owned(), role, number });
        Ok(number)
    }

    /// Composes the module.
    ///
    /// # Errors
    /// One line, if naga can read a file but not write it.
    pub fn finish(self) -> std::result::Result<Functions, String> {
        let mut wesl = include_str!("functions.wgsl").to_owned();
        for (i, file) in self.files.into_iter().enumerate() {
            let used = self.used.iter().filter(|used| used.file == i);
            let named: Vec<_> = used.map(|used| (used.name.as_str(), alias(used.role, used.number))).collect();
            wesl += &file.write(&format!("procedural_{}", letters(i as u32)), &named)?;
        }
        for (number, role) in (0..).zip(&self.surfaces) {
            let template = match role {
                Role::Distance => include_str!("distance.wgsl"),
                _ => include_str!("intersection.wgsl"),
            };
            wesl += &template.replace("SUFFIX", &letters(number));
        }
        let mut switch = |head: &str, otherwise: &str, cases: &mut dyn Iterator<Item = (u32, String)>| {
            // Writing to a string never fails.
            let _ = write!(wesl, "\n{head} {{\n    switch function {{\n");
            for (number, call) in cases {
                let _ = writeln!(wesl, "        case {number}u: {{ return {call}; }}");
            }
            let _ = write!(wesl, "        default: {{ return {otherwise}; }}\n    }}\n}}\n");
        };
        let numbers = 0..self.surfaces.len() as u32;
        switch(
            "fn procedural_next(function: u32, origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, \
             parameters: vec4f) -> vec4f",
            "NO_CROSSING",
            &mut numbers.clone().map(|i| {
                (i, format!("procedural_next_{}(origin, direction, so_far, end, epsilon, parameters)", letters(i)))
            }),
        );
        let distances = numbers.filter(|i| self.surfaces[*i as usize] == Role::Distance);
        switch(
            "fn procedural_gradient(function: u32, position: vec3f, given: vec3f, epsilon: f32, parameters: vec4f) \
             -> vec3f",
            "given",
            &mut distances.map(|i| (i, format!("procedural_gradient_{}(position, epsilon, parameters)", letters(i)))),
        );
        switch(
            "fn procedural_base(function: u32, base: vec3f, position: vec3f, parameters: vec4f) -> vec3f",
            "base",
            &mut (0..self.colours).map(|i| (i, format!("{}(base, position, parameters)", alias(Role::Colour, i)))),
        );
        Ok(Functions { wesl: wesl.into() })
    }
}

/// The name of a function in the module.
fn alias(role: Role, number: u32) -> String {
    match role {
        Role::Colour => format!("procedural_colour_{}", letters(number)),
        _ => format!("procedural_function_{}", letters(number)),
    }
}

/// A number in letters, because naga changes names that end in digits.
fn letters(number: u32) -> String {
    format!("{number:02}").bytes().map(|digit| char::from(digit - b'0' + b'a')).collect()
}
