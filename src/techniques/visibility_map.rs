//! The visibility map: photons of every light, sorted into a grid, and mended by audits.

use crate::Result;
use crate::gpu::{Buffer, Features, Gpu};
use crate::passes::grid::{Grid, GridShape, PhotonGrid};
use crate::passes::photons::Photons;
use crate::scene::Scene;
use crate::settings::Settings;
use crate::statistics::LightPhotons;
use crate::tables::SceneTables;
