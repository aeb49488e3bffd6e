//! `penumbra devices`.

use std::fmt::Write;

use kernel_kit::{DeviceChoice, Gpu};
use penumbra::Result;

use super::{Ending, print, print_json};

#[derive(clap::Args)]
pub struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let devices = Gpu::list();
    if devices.is_empty() {
        // The error of `open` explains how to get a driver.
        Gpu::open(&DeviceChoice::Best)?;
    }
    if arguments.json {
        print_json(&devices)?;
        return Ok(Ending::Done);
    }
    let mut text = String::new();
    for (index, device) in devices.iter().enumerate() {
        let timestamps = if device.timestamps { "timestamps" } else { "no timestamps" };
        let _ = writeln!(text, "{index}  {}", device.name);
        let _ = writeln!(
            text,
            "   {}, {}, buffers of {} MiB, {timestamps}",
            device.kind,
            device.driver,
            device.max_binding_bytes >> 20
        );
    }
    print(&text)?;
    Ok(Ending::Done)
}
