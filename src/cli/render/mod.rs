//! `penumbra render`.

mod arguments;
mod files;
mod frames;
mod inputs;
mod notes;
mod session;
mod technique;
mod times;

use std::time::Instant;

use penumbra::internal::report::reference::Reference;
use penumbra::{Error, Image, Result};

use super::flags::with_flags;
use super::interrupt::Interrupt;
use super::{Ending, compare, print};
use inputs::Inputs;
use notes::Notes;
use session::{Session, prepare_device};
use technique::{choose_technique, fit_denoiser};
use times::Times;

pub use arguments::Arguments;
pub use files::{both, rescue, temporary_folder, with_remark};

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let started = Instant::now();
    let interrupt = Interrupt::listen();
    arguments.check()?;
    let (mut denoiser, denoiser_error) = arguments.denoiser();
    let Inputs { mut subject, panorama, reference, mut gpu, import, start } = Inputs::load(arguments, &denoiser)?;
    let checkpoint = arguments.read_checkpoint()?;

    let mut notes = Notes::new(arguments.quiet);
    notes.say(arguments.note_on_checkpoint(checkpoint.as_ref()).as_slice());
    // The scene of each frame has notes of its own.
    if arguments.sequence.first().is_none() {
        notes.say(&subject.scene.notes);
    }
    if let Some(problem) = &denoiser_error {
        notes.say(&[format!("{}; the image stays raw", with_flags(&problem.to_string()))]);
    }

    let driver_compiles = prepare_device(&gpu, arguments.quiet);
    let sampling = fit_denoiser(arguments, &gpu, &subject.settings, &mut denoiser, &mut notes);
    let times = Times { started, import, start, sampling };
    let first_sample = choose_technique(arguments, &gpu, &mut subject, &times, driver_compiles, &mut notes);

    let mut session = Session::new(arguments, &denoiser, interrupt, times, first_sample, notes);
    if arguments.sequence.first().is_some() {
        session.render_sequence(&mut gpu, subject, panorama.as_ref())?;
    } else {
        let image = session.render_subject(&mut gpu, &subject, checkpoint)?;
        print_error(arguments, &image, reference.as_ref())?;
    }
    end(session.stopped, denoiser_error)
}

/// Prints the error of an image against its reference, if there is one.
fn print_error(arguments: &Arguments, image: &Image, reference: Option<&Reference>) -> Result<()> {
    let Some((reference, path)) = reference.zip(arguments.reference.as_deref()) else { return Ok(()) };
    let text = |image: &Image| {
        let measures = compare::measures((image, &arguments.output[0]), (&reference.image, path))?;
        Ok::<_, Error>(compare::text(&measures))
    };
    print(&text(image)?)?;
    if let Some(denoised) = image.denoised() {
        print(&format!("denoised\n{}", text(&denoised)?))?;
    }
    Ok(())
}

/// The result of a render whose images are written.
fn end(stopped: bool, denoiser_error: Option<Error>) -> Result<Ending> {
    // The raw image is written, but the user requested a denoised one.
    if let Some(problem) = denoiser_error {
        return Err(problem);
    }
    Ok(if stopped { Ending::Stopped } else { Ending::Done })
}
