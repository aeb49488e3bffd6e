//! Entrants of a report: techniques, alone or with a denoiser.

use std::{fmt, iter};

use serde::{Serialize, Serializer};

use crate::settings::{Denoise, Settings, Technique};

/// A technique, and what removes the noise of its images. Its name is that of the technique, and with a denoiser
/// `TECHNIQUE+DENOISER`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Entrant {
    /// How light is computed.
    pub technique: Technique,
    /// What removes the noise.
    pub denoise: Denoise,
}

impl Entrant {
    /// All entrants that are possible, in the order of reports: by technique, each raw image first.
    pub fn all() -> impl Iterator<Item = Entrant> {
        Technique::all().flat_map(|technique| {
            let denoised = Entrant::denoisers().map(move |denoise| Entrant { technique, denoise });
            iter::once(Entrant::raw(technique)).chain(denoised)
        })
    }

    /// The denoisers that an entrant can have.
    pub fn denoisers() -> impl Iterator<Item = Denoise> {
        Denoise::ALL.into_iter().filter(|denoise| *denoise != Denoise::None)
    }

    /// A technique alone.
    pub const fn raw(technique: Technique) -> Entrant {
        Entrant { technique, denoise: Denoise::None }
    }

    /// The entrant that renders with these settings.
    pub fn of(settings: &Settings) -> Entrant {
        Entrant { technique: settings.technique, denoise: settings.image.denoise }
    }

    /// Whether its images are denoised.
    pub fn is_denoised(self) -> bool {
        self.denoise != Denoise::None
    }
}

impl fmt::Display for Entrant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.denoise {
            Denoise::None => write!(f, "{}", self.technique),
            denoise => write!(f, "{}+{denoise}", self.technique),
        }
    }
}

impl Serialize for Entrant {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
