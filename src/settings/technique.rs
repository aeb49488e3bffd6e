//! A technique: how light is computed. Each one has a file of its own in `src/techniques/`, with its description.

use std::fmt;
use std::hash::{Hash, Hasher};

use serde::{Serialize, Serializer};

/// How light is computed. [`Technique::all`] lists all techniques; the name identifies one.
#[derive(Clone, Copy)]
pub struct Technique(&'static Description);

/// The description of a technique, independent of any scene.
pub struct Description {
    /// The name on the command line, in files and in reports.
    pub name: &'static str,
    /// What it does, in one line.
    pub help: &'static str,
    /// The publication that it follows.
    pub source: &'static str,
    /// What it requires; module `specialisation` turns this into features for a scene.
    pub requirements: Requirements,
}

/// What a technique needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Requirements {
    /// How light gets from the lights to the camera.
    pub transport: Transport,
    /// How direct light determines the visibility of a light from a shading point.
    pub visibility: Visibility,
    /// How many lights a shading point considers.
    pub lights: ConsideredLights,
}

/// How light gets from the lights to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Paths from the camera carry all light.
    Paths,
    /// Direct light is computed separately. Indirect light comes from paths and final gathers that end in the global
    /// map.
    TwoPass,
    /// The global map is shown directly, by density estimation.
    ShownMap,
    /// As [`Transport::ShownMap`], but direct light counts as unoccluded, and shadow photons subtract their energy.
    ShownMapWithNegativePhotons,
}

/// How direct light determines the visibility of a light from a shading point. Only [`Transport::TwoPass`] uses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// By shadow rays alone.
    ShadowRays,
    /// By the visibility map; shadow rays are traced at boundaries, and for audits.
    Photons,
    /// By the visibility map alone: equation 1 of the paper.
    PhotonsAlone,
    /// By shadow rays to the lights that may contribute most. The visibility of the other lights is estimated.
    Adaptive,
    /// By rays from the cells of a grid. Points in a cell from which no ray reached the light trace no shadow rays.
    Cells,
    /// By rays from the cells of a grid. Only points in cells that are neither completely lit nor completely shadowed
    /// trace shadow rays.
    Voxels,
    /// By lists of the surfaces between the lights and the point; shadow rays are traced where these do not decide.
    LightBuffer,
}

/// How many lights a shading point considers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConsideredLights {
    /// One at each vertex of a path.
    OneAtVertex,
    /// All of them.
    All,
    /// All of them, or a few if the settings request that.
    AllOrSampled,
    /// A few if there are many, sampled from the lights that reach the point's zone according to photons.
    SampledByZones,
}

impl Technique {
    /// The technique of a description, which must have a name of its own.
    pub const fn new(description: &'static Description) -> Technique {
        Technique(description)
    }

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        self.0.name
    }

    /// What it does, in one line.
    pub const fn help(self) -> &'static str {
        self.0.help
    }

    /// The publication that it follows.
    pub const fn source(self) -> &'static str {
        self.0.source
    }

    /// What it needs.
    pub const fn requirements(self) -> Requirements {
        self.0.requirements
    }

    /// Whether paths from the camera carry all light, without another pass.
    pub fn is_path_tracing(self) -> bool {
        self.requirements().transport == Transport::Paths
    }

    /// Whether separate passes compute direct and indirect light.
    pub fn is_two_pass(self) -> bool {
        self.requirements().transport == Transport::TwoPass
    }

    /// Whether it visualises the global map directly.
    pub fn shows_map(self) -> bool {
        matches!(self.requirements().transport, Transport::ShownMap | Transport::ShownMapWithNegativePhotons)
    }

    /// Whether shadow photons of that map carry negative flux, so that direct light is added as if nothing hid it.
    pub fn has_negative_photons(self) -> bool {
        self.requirements().transport == Transport::ShownMapWithNegativePhotons
    }

    /// Whether it queries the visibility map.
    pub fn uses_visibility_map(self) -> bool {
        matches!(self.requirements().visibility, Visibility::Photons | Visibility::PhotonsAlone)
    }

    /// Whether photons decide which points trace shadow rays.
    pub fn traces_by_photons(self) -> bool {
        self.requirements().visibility == Visibility::Photons
    }

    /// Whether rays from the cells of a grid determine visibility before the first sample.
    pub fn uses_cells(self) -> bool {
        matches!(self.requirements().visibility, Visibility::Cells | Visibility::Voxels)
    }

    /// Whether lists of the surfaces around each light, made before the first sample, show what may hide the light.
    pub fn uses_light_buffers(self) -> bool {
        self.requirements().visibility == Visibility::LightBuffer
    }

    /// Whether photons, cells or lists classify points as lit, shadowed or neither before shadow rays are traced.
    pub fn classifies(self) -> bool {
        self.uses_visibility_map() || self.uses_cells() || self.uses_light_buffers()
    }

    /// Whether it can use zones, for which photons determine the lights that reach them.
    pub fn uses_zones(self) -> bool {
        self.requirements().lights == ConsideredLights::SampledByZones
    }

    /// Whether its direct light may sample a few of many lights.
    pub fn samples_lights(self) -> bool {
        matches!(self.requirements().lights, ConsideredLights::AllOrSampled | ConsideredLights::SampledByZones)
    }
}

impl PartialEq for Technique {
    fn eq(&self, other: &Technique) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Technique {}

impl Hash for Technique {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.name().hash(state);
    }
}

impl fmt::Debug for Technique {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for Technique {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for Technique {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
