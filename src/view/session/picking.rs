//! Data about the pixel that the user clicks.

use super::snapshot::{Picked, PickedLight};
use super::state::{Loaded, State};
use crate::kernels::Class;
use crate::scene::Scene;
use crate::view::overlay;
use crate::view::pick::{Hit, pick};
use crate::{Channel, Result};

impl State {
    pub(super) fn hit(&self, scene: &Scene, at: [f32; 2]) -> Result<Option<Hit>> {
        Ok(pick(scene, &self.camera(scene)?, self.full_size(), at))
    }

    pub(super) fn pick(&self, at: [f32; 2]) -> Result<Option<Picked>> {
        let Some(Loaded { scene, .. }) = &self.scene else { return Ok(None) };
        let hit = self.hit(scene, at)?;
        let there = Picked { at, hit, radiance: None, lights: Vec::new(), point: None, nearest: None };
        let Some(image) = &self.image else { return Ok(Some(there)) };
        let index = |x: f32, side: u32| ((x * side as f32) as usize).min(side as usize - 1);
        let pixel = index(at[1], image.height) * image.width as usize + index(at[0], image.width);
        let radiance = image.rgb().ok().map(|rgb| rgb.map(|channel| channel[pixel]));
        let value = |name: &str| image.channel(name).map_or(0.0, |samples| samples[pixel]);
        let classes = image.channels.iter().filter(|channel| overlay::is_class(&channel.name));
        let light = |channel: &Channel| {
            let stem = channel.name.trim_end_matches(".class");
            PickedLight {
                name: stem.trim_start_matches("shadow.").to_owned(),
                class: class_name(channel.samples[pixel]),
                visibility: value(&format!("{stem}.visibility")),
                photons: ["ni", "ns"].map(|kind| value(&format!("{stem}.{kind}"))),
            }
        };
        Ok(Some(Picked { radiance, lights: classes.map(light).collect(), ..there }))
    }
}

fn class_name(class: f32) -> &'static str {
    const NAMES: [&str; Class::COUNT] = ["dark", "lit", "shadowed", "boundary", "unknown"];
    NAMES.get(class as usize).copied().unwrap_or("unknown")
}
