//! The window of `penumbra view` (Cargo feature `view`).
//!
//! A [`session`] renders a scene through a camera that moves; it knows no window. The [`worker`] is the thread that it
//! runs in. The [`panel`] turns what the user does into commands, and the [`window`] is what the system sees.

mod navigation;
mod overlay;
mod panel;
mod pick;
mod session;
mod watch;
mod window;
mod worker;

pub use overlay::{Display as Shown, Overlay};
pub use panel::{Panel, Request};
pub use pick::{Hit, pick};
pub use session::{
    Choices, Command, Eye, Picked, PickedLight, Picture, Pose, Session, Snapshot, Source, State, Viewpoint,
};
pub use window::{Display, Program};
pub use worker::{Event, Worker};
