//! The functions of a scene, collected from files into one WGSL module.

use std::fmt::Write;
use std::sync::{Arc, LazyLock};

use super::check::File;
use super::role::Role;

/// The functions of a scene's procedural objects, as the kernels are composed with them.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Functions {
    /// WESL: the module `package::lib::procedural_functions`.
    pub(crate) wesl: Arc<str>,
}

impl Default for Functions {
    /// None at all.
    fn default() -> Self {
        static NONE: LazyLock<Functions> = LazyLock::new(|| Builder::default().finish().expect("there is no file"));
        NONE.clone()
    }
}

/// Collects functions from files.
#[derive(Default)]
pub struct Builder {
    files: Vec<File>,
    surfaces: Vec<Role>,
    colours: u32,
    /// File, name, role and number of each function that is used.
    used: Vec<(usize, String, Role, u32)>,
}

impl Builder {
    /// The number of a function of a WGSL file of that text, among the colours or among the other functions.
    ///
    /// # Errors
    /// What is wrong with the file or the function, in one line.
    pub fn function(&mut self, source: &str, name: &str, role: Role) -> std::result::Result<u32, String> {
        let file = match self.files.iter().position(|file| file.source == source) {
            Some(file) => file,
            None => {
                self.files.push(File::read(source)?);
                self.files.len() - 1
            }
        };
        self.files[file].check(name, role)?;
        if let Some(used) = self.used.iter().find(|used| (used.0, used.1.as_str(), used.2) == (file, name, role)) {
            return Ok(used.3);
        }
        let number = if role == Role::Colour {
            self.colours += 1;
            self.colours - 1
        } else {
            self.surfaces.push(role);
            self.surfaces.len() as u32 - 1
        };
        self.used.push((file, name.to_owned(), role, number));
        Ok(number)
    }

    /// The module of all of them.
    ///
    /// # Errors
    /// What naga cannot write of a file, though it can read it.
    pub fn finish(self) -> std::result::Result<Functions, String> {
        let mut wesl = include_str!("functions.wgsl").to_owned();
        for (i, file) in self.files.into_iter().enumerate() {
            let used = self.used.iter().filter(|used| used.0 == i);
            let named: Vec<_> = used.map(|(_, name, role, number)| (name.as_str(), alias(*role, *number))).collect();
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
            // A string takes whatever is written.
            let _ = write!(wesl, "\n{head} {{\n    switch function {{\n");
            for (number, call) in cases {
                let _ = writeln!(wesl, "        case {number}u: {{ return {call}; }}");
            }
            let _ = write!(wesl, "        default: {{ return {otherwise}; }}\n    }}\n}}\n");
        };
        let numbers = 0..self.surfaces.len() as u32;
        switch(
            "fn procedural_next(function: u32, origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, parameters: vec4f) -> vec4f",
            "NO_CROSSING",
            &mut numbers.clone().map(|i| {
                (i, format!("procedural_next_{}(origin, direction, so_far, end, epsilon, parameters)", letters(i)))
            }),
        );
        let distances = numbers.filter(|i| self.surfaces[*i as usize] == Role::Distance);
        switch(
            "fn procedural_gradient(function: u32, place: vec3f, given: vec3f, epsilon: f32, parameters: vec4f) -> vec3f",
            "given",
            &mut distances.map(|i| (i, format!("procedural_gradient_{}(place, epsilon, parameters)", letters(i)))),
        );
        switch(
            "fn procedural_base(function: u32, base: vec3f, place: vec3f, parameters: vec4f) -> vec3f",
            "base",
            &mut (0..self.colours).map(|i| (i, format!("{}(base, place, parameters)", alias(Role::Colour, i)))),
        );
        Ok(Functions { wesl: wesl.into() })
    }
}

/// What the module calls a function of a scene.
fn alias(role: Role, number: u32) -> String {
    match role {
        Role::Colour => format!("procedural_colour_{}", letters(number)),
        _ => format!("procedural_function_{}", letters(number)),
    }
}

/// A number in letters: naga changes names that end in digits.
fn letters(number: u32) -> String {
    format!("{number:02}").bytes().map(|digit| char::from(digit - b'0' + b'a')).collect()
}
