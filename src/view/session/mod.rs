//! A session: a scene, a camera, and a render of both that continues until the picture is complete. It has no window:
//! commands change it, and each step returns a picture to show.

mod command;
mod movement;
mod picking;
mod picture;
mod rendered;
mod saving;
mod snapshot;
mod state;

use std::sync::Arc;
use std::time::{Duration, Instant};

use kernel_kit::Gpu;

use super::overlay::{self, Seen};
use crate::scene::{Camera, Scene};
use crate::settings::{Aov, Denoise, Settings};
use crate::{Denoiser, Error, Renderer, Result, Statistics};
use rendered::{Render, Subject};
use state::{Loaded, SETTLED};

pub use command::Command;
pub use picture::{Choices, Eye, Picture, Pose, Source, Viewpoint};
pub use snapshot::{Picked, PickedLight, Snapshot};
pub use state::State;

/// The time of a picture while the camera moves: twelve pictures a second.
const MOVING_PICTURE: Duration = Duration::from_millis(80);

/// Divisor of the sides of the first picture: 640 x 360 pixels become 160 x 90. At that size preparation takes longer
/// than the sample (docs/view.md), and the scene can still be recognised.
const FIRST_DIVISOR: u32 = 4;

/// Largest factor by which the sides of the picture are divided while the camera moves.
const MAX_DIVISOR: u32 = 8;

/// The channels that the film keeps besides the picture. They do not change it, and without them another overlay would
/// begin the picture again.
const KEPT: [Aov; 4] = [Aov::Albedo, Aov::Normal, Aov::Depth, Aov::Samples];

/// A session on a device.
pub struct Session<'g> {
    gpu: &'g Gpu,
    denoiser: Denoiser,
    state: State,
    render: Option<Render<'g>>,
    /// The inputs that could not be rendered.
    failed: Option<(Subject, Eye)>,
    /// The picture is to be shown anew without being rendered anew.
    is_stale: bool,
    /// Whether the camera moved when the last step began.
    was_moving: bool,
}

impl<'g> Session<'g> {
    /// Continues `state` on a device, which from now on keeps its kernels.
    pub fn new(gpu: &'g Gpu, mut state: State) -> Session<'g> {
        gpu.keep_kernels();
        let (denoiser, problem) = state.source.denoiser();
        if let Some(problem) = problem {
            state.say(format!("{problem}; the picture stays raw"));
        }
        Session { gpu, denoiser, state, render: None, failed: None, is_stale: true, was_moving: false }
    }

    /// The part that does not depend on the device, for another one.
    pub fn into_state(self) -> State {
        self.state
    }

    /// The part that does not depend on the device.
    pub fn state(&mut self) -> &mut State {
        &mut self.state
    }

    /// What is shown.
    pub fn snapshot(&self) -> Snapshot {
        self.state.snapshot()
    }

    /// Statistics of the picture; `None` before there is one.
    ///
    /// # Errors
    /// As [`Renderer::statistics`].
    pub fn statistics(&self) -> Result<Option<Statistics>> {
        self.render.as_ref().map(|render| render.renderer.statistics()).transpose()
    }

    /// Executes a command. One that fails leaves a message.
    pub fn command(&mut self, command: Command) {
        // A movement is shown once it is rendered.
        let moves = matches!(command, Command::Orbit(_) | Command::Pan(_) | Command::Dolly(_) | Command::Fly(_));
        if let Err(problem) = self.state.apply(command) {
            self.state.say(problem.to_string());
        }
        self.is_stale |= !moves;
    }

    /// How long the next step can wait if there is nothing else to do; `None`: until a command comes.
    pub fn wait(&self) -> Option<Duration> {
        let moved = self.state.moved.filter(|_| self.was_moving);
        moved.map(|moved| SETTLED.saturating_sub(moved.elapsed()))
    }

    /// Does a part of what is left to do, such as a batch of samples. Returns a picture if there is a new one, and
    /// whether more is left.
    ///
    /// # Errors
    /// [`Error::DeviceLost`]: continue [the state](Session::into_state) on another device. Other errors leave a
    /// message.
    pub fn step(&mut self) -> Result<(Option<Snapshot>, bool)> {
        let started = Instant::now();
        let said = self.state.message.clone();
        let worked = match self.advance() {
            Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
            Err(problem) => {
                self.state.say(problem.to_string());
                false
            }
            Ok(worked) => worked,
        };
        if worked {
            self.state.seconds = started.elapsed().as_secs_f64();
            self.adapt();
        }
        if !worked && !self.is_stale && said == self.state.message {
            return Ok((None, false));
        }
        self.is_stale = false;
        match self.show() {
            Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
            Err(problem) => self.state.say(problem.to_string()),
            Ok(()) => {}
        }
        Ok((Some(self.state.snapshot()), worked))
    }

    /// Divides the picture more or less while the camera moves, by the time of the last step.
    fn adapt(&mut self) {
        let full = self.state.full_size();
        let is_divided = self.render.as_ref().is_some_and(|render| render.size != full);
        if !self.was_moving || !is_divided {
            return;
        }
        let took = Duration::from_secs_f64(self.state.seconds);
        if took > 2 * MOVING_PICTURE {
            self.state.divisor = (2 * self.state.divisor).min(MAX_DIVISOR);
        } else if took < MOVING_PICTURE / 4 {
            // Four times as many pixels take less than four times as long.
            self.state.divisor = (self.state.divisor / 2).max(1);
        }
    }

    /// Loads, prepares or renders. Returns whether there was anything to do.
    fn advance(&mut self) -> Result<bool> {
        let is_moving = self.state.is_moving();
        self.was_moving = is_moving;
        self.state.load()?;
        let Some(Loaded { scene, origin }) = self.state.scene.clone() else { return Ok(false) };
        let eye = self.state.eye.clone();
        let camera = self.state.camera(&scene)?;
        let settings = self.settings();
        let subject = Subject { origin, settings, has_lens: camera.lens.is_some() };
        if self.failed.as_ref().is_some_and(|failed| *failed == (subject.clone(), eye.clone())) {
            return Ok(false);
        }
        let outcome = match &mut self.render {
            Some(render) if render.subject == subject => {
                let full = self.state.full_size();
                let size = if is_moving { self.state.divided_size(self.state.divisor) } else { full };
                let is_there = render.size == size || (is_moving && render.size == full);
                let keeps = render.eye == eye && is_there && (is_moving || !render.is_preview);
                if keeps { Ok(()) } else { render.set_view(&eye, camera, size, is_moving) }
            }
            // The last picture is shown in the new size until the size stays.
            Some(render) if is_moving && render.subject.is_resized(&subject) => return Ok(false),
            _ => self.prepare(&scene, subject.clone(), eye.clone(), camera),
        };
        if let Err(problem) = outcome {
            self.failed = Some((subject, eye));
            // A renderer that refused a view still has the last one.
            if !matches!(problem, Error::Setting { .. } | Error::Usage(_) | Error::Memory { .. }) {
                self.render = None;
            }
            return Err(problem);
        }
        self.failed = None;
        self.sample(is_moving)
    }

    /// The settings of the renderer.
    fn settings(&self) -> Settings {
        let Choices { settings, display, .. } = &self.state.choices;
        settings.clone().with(|s| {
            s.image.denoise = self.denoiser.choice();
            s.image.aovs.extend(KEPT);
            s.image.aovs.extend(display.overlay.aov());
            if display.overlay.requires_photons() {
                s.visibility_map.photons_per_light = Some(settings.photons_per_light());
            }
            s.image.aovs.sort();
            s.image.aovs.dedup();
        })
    }

    fn prepare(&mut self, scene: &Scene, subject: Subject, eye: Eye, camera: Camera) -> Result<()> {
        // Two renderers would need twice the memory.
        self.render = None;
        // Another render may have other photons.
        self.state.picked.iter_mut().for_each(|picked| picked.nearest = None);
        // A small picture comes first, as while the camera moves; visibility photons come after it.
        let size = self.state.divided_size(FIRST_DIVISOR);
        let renderer = Renderer::with_preview(self.gpu, scene.clone(), &camera, &subject.settings, size)?;
        self.state.message = None;
        self.render = Some(Render {
            renderer,
            subject,
            eye,
            camera,
            size,
            is_preview: true,
            is_first: true,
            photons: None,
            is_raw: false,
        });
        Ok(())
    }

    /// Renders a batch and takes the image, unless all samples are there. While the camera moves, one is enough.
    fn sample(&mut self, is_moving: bool) -> Result<bool> {
        let Some(render) = &mut self.render else { return Ok(false) };
        let renderer = &mut render.renderer;
        let is_first = renderer.samples() == 0;
        if (is_moving && !is_first) || !renderer.wants_samples(&self.denoiser)? {
            return Ok(false);
        }
        if is_first {
            renderer.render_up_to(1)?
        } else {
            renderer.render_batch()?
        };
        self.state.is_complete = !render.is_preview && !renderer.wants_samples(&self.denoiser)?;
        self.state.samples = renderer.samples();
        let has_denoiser = self.denoiser.choice() != Denoise::None && !render.is_raw;
        let is_denoised = has_denoiser && self.state.choices.display.requires_denoising();
        let was_denoised = self.state.image.as_ref().is_some_and(|image| image.channel("denoised.R").is_some());
        // Denoising takes as long as some samples.
        let is_due = self.state.samples.is_power_of_two() || !was_denoised;
        if is_denoised && !is_due && !self.state.is_complete {
            return Ok(true);
        }
        let mut image = renderer.image()?;
        // Denoisers take long to begin, and the first picture is not to wait for them.
        let is_denoised = (is_denoised || has_denoiser && self.state.is_complete) && !render.is_first;
        match if is_denoised { renderer.add_denoised(&mut image, &self.denoiser) } else { Ok(()) } {
            Err(lost @ Error::DeviceLost { .. }) => return Err(lost),
            Err(problem) => {
                render.is_raw = true;
                self.state.say(format!("{problem}; the picture stays raw"));
            }
            Ok(()) => {}
        }
        self.state.image = Some(image);
        Ok(true)
    }

    /// Finds the point of the pixel that was clicked, and the photons that decide it for the light that is shown.
    fn find_picked(&mut self) -> Result<()> {
        let (Some(image), Some(render)) = (&self.state.image, &mut self.render) else { return Ok(()) };
        let Some(picked) = &mut self.state.picked else { return Ok(()) };
        let is_shown = [image.width, image.height] == render.size && render.eye == self.state.eye;
        if is_shown && self.state.is_point_due {
            picked.point = render.point(picked.at)?;
            picked.nearest = None;
            // A pixel of a small picture covers several of the whole one.
            self.state.is_point_due = render.is_preview;
        }
        let light = self.state.choices.display.light;
        if picked.nearest.as_ref().is_none_or(|nearest| nearest.light as usize != light) {
            picked.nearest = picked.point.map(|point| render.nearest(point, light)).transpose()?.flatten();
        }
        Ok(())
    }

    /// Makes the pixels that are shown.
    fn show(&mut self) -> Result<()> {
        self.find_picked()?;
        let (Some(image), Some(render)) = (&self.state.image, &mut self.render) else { return Ok(()) };
        let display = self.state.choices.display;
        let is_same_size = [image.width, image.height] == render.size;
        let picked = self.state.picked.as_ref().filter(|_| is_same_size);
        let nearest = picked.and_then(|picked| picked.nearest.as_ref());
        let is_photons = display.overlay == overlay::Overlay::Photons;
        if is_photons {
            render.photons()?;
        }
        let photons = render.photons.as_deref().filter(|_| is_photons && is_same_size).unwrap_or_default();
        let is_cells = display.overlay == overlay::Overlay::Cells && is_same_size;
        let cells = if is_cells { render.renderer.shown_cells(display.light as u32)? } else { None };
        let scale = self.state.scene.as_ref().map_or(1.0, |loaded| loaded.scene.normalisation.scale());
        let seen = Seen { photons, cells: cells.as_deref(), nearest, camera: &render.camera, scale };
        self.state.pixels = Arc::new(overlay::pixels(image, &display, seen));
        self.state.size = [image.width, image.height];
        Ok(())
    }
}
