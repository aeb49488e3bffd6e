//! The window of `penumbra view` (Cargo feature `view`).
//!
//! A [`session`] renders a scene through a moving camera, without a window. The [`worker`] is the thread that it runs
//! in. The [`panel`] turns the user's actions into commands, and the [`window`] connects both to the system.

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
