//! Sequences: a render for each frame that is not complete yet.

use std::cell::OnceCell;
use std::time::Instant;

use kernel_kit::Gpu;
use penumbra::internal::scene::Normalisation;
use penumbra::{Camera, Result, Scene, Settings};

use super::arguments::Arguments;
use super::inputs::{Subject, turntable};
use super::session::Session;
use crate::cli::options::LoadedPanorama;
use crate::cli::say;
use crate::cli::sequence::Frame;

/// What the frames of a sequence have in common.
struct Sequence<'a> {
    arguments: &'a Arguments,
    panorama: Option<&'a LoadedPanorama>,
    /// All frames have the size of the first.
    settings: Settings,
    /// The camera at the beginning of the animation, and the space that it is in, once a frame has needed it. If the
    /// camera frames the scene, all frames have this one: a camera that frames each frame anew would move with the
    /// scene, and one that frames the first frame would differ between processes that render a part of the frames each.
    beginning: OnceCell<(Camera, Normalisation)>,
    /// The cameras of a turntable, and its scene, which stands still.
    views: Vec<Camera>,
    standing: Option<Scene>,
}

impl<'a> Sequence<'a> {
    fn new(arguments: &'a Arguments, first: &Subject, panorama: Option<&'a LoadedPanorama>) -> Result<Sequence<'a>> {
        let Subject { scene, settings, .. } = first;
        let views = turntable(arguments, scene)?.unwrap_or_default();
        Ok(Sequence {
            arguments,
            panorama,
            settings: settings.clone(),
            beginning: OnceCell::new(),
            standing: (!views.is_empty()).then(|| scene.clone()),
            views,
        })
    }

    /// The scene and the camera of a frame.
    fn load(&self, frame: Frame) -> Result<Subject> {
        let arguments = self.arguments;
        let mut scene = match &self.standing {
            Some(scene) => scene.clone(),
            None => arguments.scene.load_at(frame.seconds)?,
        };
        if let Some(panorama) = self.panorama.filter(|_| self.standing.is_none()) {
            arguments.scene.set_panorama(&mut scene, panorama)?;
        }
        let camera = self.camera(frame, &scene)?;
        if self.standing.is_none() {
            arguments.scene.add_notes(&mut scene, &camera);
        }
        Ok(Subject { scene, camera, settings: self.settings.clone() })
    }

    /// The camera of a frame, which shows this scene.
    fn camera(&self, frame: Frame, scene: &Scene) -> Result<Camera> {
        let options = &self.arguments.scene;
        if let Some(view) = self.views.get(frame.number as usize) {
            return Ok(view.clone());
        }
        let camera_of = |scene: &Scene| options.camera(scene, self.arguments.settings.aspect());
        if !options.frames(scene) {
            return camera_of(scene);
        }
        let (camera, space) = match self.beginning.get() {
            Some(beginning) => beginning,
            None => {
                let loaded;
                let beginning = match frame.number {
                    0 => scene,
                    _ => {
                        loaded = options.load_at(Some(0.0))?;
                        &loaded
                    }
                };
                let camera = camera_of(beginning)?;
                self.beginning.get_or_init(|| (camera, beginning.normalisation))
            }
        };
        Ok(camera.renormalised(space, &scene.normalisation))
    }

    /// Says which frame is rendered.
    fn announce(&self, frame: Frame) {
        match frame.seconds {
            Some(seconds) => say(format_args!("frame {} at {seconds:.3} s", frame.number)),
            // Views count from 0, as their files do.
            None => say(format_args!("view {} of 0 to {}", frame.number, self.views.len() - 1)),
        }
    }

    /// Says that the files of a frame are there.
    fn announce_complete(&self, frame: Frame) {
        let what = if frame.seconds.is_some() { "frame" } else { "view" };
        say(format_args!("{what} {} is complete", frame.number));
    }
}

impl Session<'_> {
    /// Renders the missing frames of a sequence; `first` is the first of all frames.
    pub fn render_sequence(&mut self, gpu: &mut Gpu, first: Subject, panorama: Option<&LoadedPanorama>) -> Result<()> {
        let arguments = self.arguments;
        let sequence = Sequence::new(arguments, &first, panorama)?;
        let mut first = Some(first);
        let shared_notes = self.notes.current().len();
        for frame in arguments.sequence.frames().into_iter().flatten() {
            if self.interrupt.raised() {
                self.stopped = true;
                break;
            }
            let mut subject = match first.take() {
                Some(mut first) => {
                    first.camera = sequence.camera(frame, &first.scene)?;
                    first
                }
                None => {
                    (self.times.started, self.times.start) = (Instant::now(), 0.0);
                    let subject = sequence.load(frame)?;
                    self.times.import = self.times.started.elapsed().as_secs_f64();
                    subject
                }
            };
            subject.settings.image.seed = sequence.settings.image.seed.wrapping_add(frame.seed);
            self.files = arguments.files(Some(frame));
            let fingerprint = self.fingerprint_of(&subject);
            if self.files.are_complete(&fingerprint) {
                if !arguments.quiet {
                    sequence.announce_complete(frame);
                }
                continue;
            }
            if !arguments.quiet {
                sequence.announce(frame);
            }
            self.notes.begin_frame(shared_notes);
            self.notes.say(&subject.scene.notes);
            self.fingerprint = Some(fingerprint);
            self.render_subject(gpu, &subject, None)?;
            if self.stopped {
                break;
            }
        }
        Ok(())
    }

    /// Identifies a frame by everything that decides the content of its files.
    fn fingerprint_of(&self, Subject { scene, camera, settings }: &Subject) -> String {
        let Arguments { time, view, exposure, .. } = self.arguments;
        let denoisers: Vec<&str> = self.denoiser.names().collect();
        scene.fingerprint(&(camera, settings, *time, denoisers.as_slice(), *view, *exposure))
    }
}
