//! The window's content: the picture with its camera controls, and the panel beside it. It turns the user's actions
//! into requests.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use egui::{
    CentralPanel, Color32, ColorImage, ComboBox, Frame, Image, Key, Modifiers, Panel as SidePanel, PointerButton, Pos2,
    Rect, Response, ScrollArea, Sense, Slider, SliderClamping, TextureHandle, TextureOptions, Ui, Vec2,
};
use kernel_kit::Compilation;

use super::overlay::Overlay;
use super::session::{Choices, Command, Picked, Snapshot, Viewpoint};
use crate::Technique;
use crate::render::film::View;

/// Width of the panel in points.
pub const WIDTH: f32 = 270.0;

/// Points of scrolling that bring the camera nearer by a factor of e. A step of a mouse wheel is 40 points (egui),
/// and brings it nearer by 15 %.
const SCROLL_STEP: f64 = 250.0;

/// Shares of the scene's size that the camera flies in a second.
const FLIGHT: f64 = 0.7;

/// Maximum seconds that a flight counts between two pictures of the panel: before the first one the panel may have
/// rested for long.
const MAX_STEP: f32 = 0.1;

/// Largest f-number of the panel; beyond, everything is sharp.
const MAX_F_NUMBER: f64 = 22.0;

/// The keys of the overlays.
const OVERLAY_KEYS: [Key; Overlay::ALL.len()] =
    [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8, Key::Num9];

/// A request of the user.
#[derive(Clone, Debug)]
pub enum Request {
    /// A command for the session.
    Command(Command),
    /// The command that renders the picture.
    Copy,
    /// The end.
    Quit,
}

/// A copy of the scene that is to have the camera.
#[derive(Default)]
struct Copy {
    /// The scene that `file` was named after.
    of: PathBuf,
    file: String,
    name: String,
    replaces: bool,
}

impl Copy {
    /// Names the file after another scene: `scene.view.glb` for `scene.glb`, beside it.
    fn name_after(&mut self, scene: &Path) {
        if self.of != scene {
            self.of = scene.to_owned();
            let extension = scene.extension().unwrap_or_default().to_string_lossy();
            self.file = scene.with_extension(format!("view.{extension}")).display().to_string();
            self.replaces = false;
        }
    }
}

/// The content of the window.
pub struct Panel {
    /// Whether the picture has the size of the window, and not one of its own.
    follows_window: bool,
    /// The user's choices; `None` before the first picture.
    choices: Option<Choices>,
    /// The scene that they are for.
    scene: PathBuf,
    fov: f64,
    f_number: Option<f64>,
    f_number_of_picture: Option<f64>,
    file: String,
    /// The copy of the scene with the camera, the camera's name, and whether the copy may replace a file.
    copy: Copy,
    texture: Option<TextureHandle>,
    /// The picture in the texture.
    shown: Option<Arc<Vec<u8>>>,
    /// The size that was requested last.
    resized: Option<[u32; 2]>,
    /// The last command that was copied.
    copied: Option<String>,
    /// Progress of the driver in compiling kernels; `None` once it has them.
    compilation: Option<Compilation>,
}

impl Panel {
    /// `follows_window`: the picture gets the size that the window has for it.
    pub fn new(follows_window: bool) -> Panel {
        Panel {
            follows_window,
            choices: None,
            scene: PathBuf::new(),
            fov: 0.0,
            f_number: None,
            f_number_of_picture: None,
            file: "picture.png".to_owned(),
            copy: Copy { name: "view".to_owned(), ..Copy::default() },
            texture: None,
            shown: None,
            resized: None,
            copied: None,
            compilation: None,
        }
    }

    /// Shows that a command was copied.
    pub fn copied(&mut self, command: String) {
        self.copied = Some(command);
    }

    /// Shows how far the driver is with kernels, until it has them.
    pub fn compiling(&mut self, compilation: Compilation) {
        self.compilation = Some(compilation).filter(|Compilation { done, all }| done < all);
    }

    /// Forgets what the last device held.
    pub fn forget_device(&mut self) {
        (self.texture, self.shown, self.compilation) = (None, None, None);
    }

    /// Lays out the window before the first picture. Returns whether the user quits.
    pub fn wait(&self, ui: &mut Ui) -> bool {
        let text = self.compilation.map_or("preparing the scene".to_owned(), |compilation| compilation.to_string());
        ui.centered_and_justified(|ui| ui.label(text));
        quits(ui)
    }

    /// Lays out the window.
    pub fn show(&mut self, ui: &mut Ui, snapshot: &Snapshot) -> Vec<Request> {
        let mut requests = Vec::new();
        let picture = &snapshot.picture;
        if self.scene != picture.file {
            self.scene.clone_from(&picture.file);
            self.choices.iter_mut().for_each(|choices| choices.pose = picture.choices.pose.clone());
        }
        // A camera without an iris has no f-number. Its other changes come from the slider, and pictures lag behind it.
        let f_number = picture.eye.f_number;
        if f_number.is_some() != self.f_number_of_picture.is_some() {
            self.f_number = f_number;
        }
        self.f_number_of_picture = f_number;
        SidePanel::right("panel").exact_size(WIDTH).resizable(false).show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| self.controls(ui, snapshot, &mut requests));
        });
        CentralPanel::default().frame(Frame::NONE.fill(Color32::from_gray(24))).show(ui, |ui| {
            self.picture(ui, snapshot, &mut requests);
        });
        self.shortcuts(ui, &mut requests);
        requests
    }

    /// Keys that stand for the panel's buttons. Text fields take those that they need.
    fn shortcuts(&mut self, ui: &Ui, requests: &mut Vec<Request>) {
        if quits(ui) {
            requests.push(Request::Quit);
        }
        if ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        if ui.input(|input| input.events.contains(&egui::Event::Copy)) {
            requests.push(Request::Copy);
        }
        if is_pressed(ui, Key::S) {
            requests.push(self.save());
        }
        if ui.input(|input| input.key_pressed(Key::Escape)) {
            requests.push(Request::Command(Command::Unpick));
        }
        let overlay = OVERLAY_KEYS.into_iter().position(|key| ui.input(|input| input.key_pressed(key)));
        if let (Some(overlay), Some(choices)) = (overlay, &mut self.choices) {
            choices.display.overlay = Overlay::ALL[overlay];
            requests.push(Request::Command(Command::Choose(Box::new(choices.clone()))));
        }
    }

    fn save(&self) -> Request {
        Request::Command(Command::Save(self.file.trim().into()))
    }

    /// The picture, and what moves its camera.
    fn picture(&mut self, ui: &mut Ui, snapshot: &Snapshot, requests: &mut Vec<Request>) {
        let pixels_per_point = ui.ctx().pixels_per_point();
        let room = ui.available_rect_before_wrap();
        if self.follows_window {
            let size = [room.width(), room.height()].map(|side| (side * pixels_per_point).round() as u32);
            // A window without room keeps the picture it had.
            if size.iter().all(|side| *side > 0) && self.resized != Some(size) {
                self.resized = Some(size);
                requests.push(Request::Command(Command::Resize(size)));
            }
        }
        let image = &snapshot.picture.choices.settings.image;
        let full = Vec2::new(image.width as f32, image.height as f32) / pixels_per_point;
        let scale = (room.size() / full).min_elem().min(1.0);
        // On whole pixels, so that each pixel of the picture is one of the window.
        let whole = |x: f32| (x * pixels_per_point).round() / pixels_per_point;
        let corner = room.center() - 0.5 * scale * full;
        let rect = Rect::from_min_size(Pos2::new(whole(corner.x), whole(corner.y)), scale * full);
        if !(rect.is_positive() && rect.is_finite()) {
            return;
        }
        self.upload(ui, snapshot);
        if let Some(texture) = &self.texture {
            Image::new((texture.id(), rect.size())).paint_at(ui, rect);
        }
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "the picture"));
        requests.extend(movements(ui, &response).into_iter().map(Request::Command));
    }

    /// Brings the pixels of the snapshot to the device.
    fn upload(&mut self, ui: &Ui, snapshot: &Snapshot) {
        let is_shown = self.shown.as_ref().is_some_and(|shown| Arc::ptr_eq(shown, &snapshot.pixels));
        if is_shown || snapshot.pixels.is_empty() {
            return;
        }
        let size = snapshot.size.map(|side| side as usize);
        let image = ColorImage::from_rgb(size, &snapshot.pixels);
        match &mut self.texture {
            Some(texture) => texture.set(image, TextureOptions::LINEAR),
            None => self.texture = Some(ui.ctx().load_texture("picture", image, TextureOptions::LINEAR)),
        }
        self.shown = Some(snapshot.pixels.clone());
    }

    fn controls(&mut self, ui: &mut Ui, snapshot: &Snapshot, requests: &mut Vec<Request>) {
        status(ui, snapshot);
        if let Some(compilation) = self.compilation {
            ui.label(compilation.to_string());
        }
        ui.separator();
        self.camera(ui, snapshot, requests);
        ui.separator();
        let mut choices = self.choices.take().unwrap_or_else(|| snapshot.picture.choices.clone());
        let before = choices.clone();
        display(ui, snapshot, &mut choices);
        ui.separator();
        light(ui, snapshot, &mut choices);
        if choices != before {
            requests.push(Request::Command(Command::Choose(Box::new(choices.clone()))));
        }
        self.choices = Some(choices);
        ui.separator();
        self.output(ui, requests);
        self.copy(ui, snapshot, requests);
        if let Some(picked) = &snapshot.picked {
            ui.separator();
            picked_details(ui, picked);
        }
    }

    fn camera(&mut self, ui: &mut Ui, snapshot: &Snapshot, requests: &mut Vec<Request>) {
        let current = &snapshot.picture.eye.viewpoint;
        let name = match current {
            Viewpoint::Given => "as given".to_owned(),
            Viewpoint::Default => "default".to_owned(),
            Viewpoint::File(index) => snapshot.cameras.get(*index).cloned().unwrap_or_default(),
            Viewpoint::Placed(_) => "moved".to_owned(),
        };
        let mut command = |command| requests.push(Request::Command(command));
        ComboBox::from_label("camera").selected_text(name).show_ui(ui, |ui| {
            if ui.selectable_label(*current == Viewpoint::Given, "as given").clicked() {
                command(Command::Camera(Viewpoint::Given));
            }
            for (index, name) in snapshot.cameras.iter().enumerate() {
                if ui.selectable_label(*current == Viewpoint::File(index), name).clicked() {
                    command(Command::Camera(Viewpoint::File(index)));
                }
            }
        });
        if let Some(fov) = snapshot.fov {
            let slid = ui.add(slider(&mut self.fov, 5.0..=120.0).suffix("°").text("field of view"));
            if slid.changed() {
                command(Command::FieldOfView(self.fov));
            } else if !slid.dragged() && !slid.has_focus() {
                self.fov = fov;
            }
            let mut has_lens = self.f_number.is_some();
            let toggled = ui.checkbox(&mut has_lens, "depth of field").changed();
            if toggled {
                self.f_number = has_lens.then_some(2.8);
            }
            let slid = self.f_number.as_mut().is_some_and(|f_number| {
                ui.add(slider(f_number, 0.5..=MAX_F_NUMBER).logarithmic(true).text("f-number")).changed()
            });
            if toggled || slid {
                command(Command::Aperture(self.f_number));
            }
        }
        if ui.button("frame all").on_hover_text("Home: shows the whole scene").clicked() {
            command(Command::FrameAll);
        }
    }

    fn output(&mut self, ui: &mut Ui, requests: &mut Vec<Request>) {
        if ui.button("copy command").on_hover_text("Ctrl+C: the `penumbra render` command of this picture").clicked() {
            requests.push(Request::Copy);
        }
        if let Some(copied) = &self.copied {
            ui.label(egui::RichText::new(copied).small().monospace());
        }
        ui.horizontal(|ui| {
            ui.add(egui::TextEdit::singleline(&mut self.file).desired_width(150.0));
            if ui.button("save").on_hover_text("Ctrl+S: saves the picture as .png or .exr").clicked() {
                requests.push(self.save());
            }
        });
    }

    /// Controls that write the camera into a copy of the scene.
    fn copy(&mut self, ui: &mut Ui, snapshot: &Snapshot, requests: &mut Vec<Request>) {
        self.copy.name_after(&snapshot.picture.file);
        let Copy { file, name, replaces, .. } = &mut self.copy;
        for (text, label) in [(&mut *name, "camera's name"), (&mut *file, "copy of the scene")] {
            ui.horizontal(|ui| {
                let field = ui.add(egui::TextEdit::singleline(text).desired_width(140.0));
                let label = ui.label(label);
                field.labelled_by(label.id);
            });
        }
        ui.horizontal(|ui| {
            if ui.button("save camera").on_hover_text("writes the camera into a copy of the scene").clicked() {
                let (file, name, replaces) = (file.trim().into(), name.clone(), *replaces);
                requests.push(Request::Command(Command::SaveCamera { file, name, replaces }));
            }
            ui.checkbox(replaces, "replace").on_hover_text("overwrite the file if it exists");
        });
    }
}

/// Commands of the pointer and the keys to the camera.
fn movements(ui: &Ui, response: &Response) -> Vec<Command> {
    let mut commands = Vec::new();
    let shares = |by: Vec2| [by.x, by.y].map(|x| f64::from(x / response.rect.height()));
    let point = |at: Pos2| {
        let at = (at - response.rect.min) / response.rect.size();
        [at.x, at.y].map(|x| x.clamp(0.0, 1.0))
    };
    // The scene follows the pointer.
    let [right, down] = shares(response.drag_delta());
    let is_shifted = ui.input(|input| input.modifiers.shift);
    if response.dragged_by(PointerButton::Middle) || (response.dragged_by(PointerButton::Primary) && is_shifted) {
        commands.push(Command::Pan([-right, down]));
    } else if response.dragged_by(PointerButton::Primary) {
        commands.push(Command::Orbit([-right, down]));
    }
    if let Some(at) = response.interact_pointer_pos() {
        if response.double_clicked() {
            commands.push(Command::FrameAt(point(at)));
        } else if response.clicked() {
            commands.push(Command::Pick(point(at)));
        }
    }
    if response.hovered() {
        let scrolled = ui.input(|input| input.smooth_scroll_delta.y);
        if scrolled != 0.0 {
            commands.push(Command::Dolly(f64::from(scrolled) / SCROLL_STEP));
        }
    }
    if ui.ctx().egui_wants_keyboard_input() {
        return commands;
    }
    if ui.input(|input| input.key_pressed(Key::Home)) {
        commands.push(Command::FrameAll);
    }
    if let Some(at) = response.hover_pos().filter(|_| ui.input(|input| input.key_pressed(Key::F))) {
        commands.push(Command::FrameAt(point(at)));
    }
    let axis =
        |plus, minus| ui.input(|i| f64::from(u8::from(i.key_down(plus))) - f64::from(u8::from(i.key_down(minus))));
    let direction = [axis(Key::D, Key::A), axis(Key::E, Key::Q), axis(Key::W, Key::S)];
    let is_command = ui.input(|input| input.modifiers.command);
    if direction != [0.0; 3] && !is_command {
        let seconds = f64::from(ui.input(|input| input.stable_dt).min(MAX_STEP));
        commands.push(Command::Fly(direction.map(|x| x * seconds * FLIGHT)));
        ui.ctx().request_repaint();
    }
    commands
}

/// Whether a key is pressed with the command key.
fn is_pressed(ui: &Ui, key: Key) -> bool {
    // With the modifiers of the moment: a slow window hears a key and its release at once.
    ui.input_mut(|input| input.consume_key(Modifiers::COMMAND, key))
}

fn quits(ui: &Ui) -> bool {
    is_pressed(ui, Key::Q)
}

fn status(ui: &mut Ui, snapshot: &Snapshot) {
    let file = snapshot.picture.file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    ui.strong(file);
    let image = &snapshot.picture.choices.settings.image;
    let state = if snapshot.is_complete { "complete" } else { "rendering" };
    ui.label(format!("{} x {} pixels", image.width, image.height));
    ui.label(format!("{} of {} samples, {state}", snapshot.samples, image.spp));
    ui.label(format!("last step {:.0} ms", 1e3 * snapshot.seconds));
    if let Some(message) = &snapshot.message {
        ui.colored_label(ui.visuals().warn_fg_color, message);
    }
}

/// A slider that leaves a value beyond its range as it is, until the user moves it.
fn slider<N: egui::emath::Numeric>(value: &mut N, range: RangeInclusive<N>) -> Slider<'_> {
    Slider::new(value, range).clamping(SliderClamping::Edits)
}

fn display(ui: &mut Ui, snapshot: &Snapshot, choices: &mut Choices) {
    let display = &mut choices.display;
    ComboBox::from_label("show").selected_text(display.overlay.name()).show_ui(ui, |ui| {
        for overlay in Overlay::ALL {
            ui.selectable_value(&mut display.overlay, overlay, overlay.name());
        }
    });
    if !display.overlay.legend().is_empty() {
        ui.small(display.overlay.legend());
    }
    // A file that is read again may have fewer.
    if display.light >= snapshot.lights.len() {
        display.light = 0;
    }
    if display.overlay.is_of_a_light() {
        let name = snapshot.lights.get(display.light).map_or("none", String::as_str);
        ComboBox::from_label("light").selected_text(name).show_ui(ui, |ui| {
            for (index, name) in snapshot.lights.iter().enumerate() {
                ui.selectable_value(&mut display.light, index, name);
            }
        });
    }
    ui.add(slider(&mut display.exposure, -8.0..=8.0).suffix(" EV").text("exposure"));
    ComboBox::from_label("tone mapping").selected_text(display.view.to_string()).show_ui(ui, |ui| {
        for view in View::ALL {
            ui.selectable_value(&mut display.view, view, view.to_string());
        }
    });
    ui.checkbox(&mut display.denoised, "denoised");
}

fn light(ui: &mut Ui, snapshot: &Snapshot, choices: &mut Choices) {
    let settings = &mut choices.settings;
    ComboBox::from_label("technique").selected_text(settings.technique.name()).show_ui(ui, |ui| {
        let is_allowed = |technique: &Technique| settings.clone().with(|s| s.technique = *technique).check().is_ok();
        for technique in Technique::all().filter(is_allowed).collect::<Vec<_>>() {
            ui.selectable_value(&mut settings.technique, technique, technique.name()).on_hover_text(technique.help());
        }
    });
    ui.add(slider(&mut settings.image.spp, 1..=4096).logarithmic(true).text("samples"));
    ui.add(slider(&mut settings.light_scale, 0.0..=16.0).logarithmic(true).text("light scale"));
    if snapshot.has_panorama {
        let mut rotation = choices.pose.environment_rotation.unwrap_or(0.0);
        let slider = slider(&mut rotation, -180.0..=180.0).suffix("°").text("environment");
        if ui.add(slider).changed() {
            choices.pose.environment_rotation = Some(rotation);
        }
    }
    if let Some(end) = snapshot.animation_end {
        let mut is_posed = choices.pose.time.is_some();
        if ui.checkbox(&mut is_posed, "animation").changed() {
            choices.pose.time = is_posed.then_some(0.0);
        }
        if let Some(time) = &mut choices.pose.time {
            ui.add(slider(time, 0.0..=end).suffix(" s").text("time"));
        }
    }
    if !snapshot.variants.is_empty() {
        let name = choices.pose.variant.as_deref().unwrap_or("of the file");
        ComboBox::from_label("materials").selected_text(name.to_owned()).show_ui(ui, |ui| {
            ui.selectable_value(&mut choices.pose.variant, None, "of the file");
            for variant in &snapshot.variants {
                ui.selectable_value(&mut choices.pose.variant, Some(variant.clone()), variant);
            }
        });
    }
}

fn picked_details(ui: &mut Ui, picked: &Picked) {
    let [x, y] = picked.at.map(|x| 100.0 * x);
    ui.label(format!("at {x:.0} % from the left, {y:.0} % from the top"));
    match &picked.hit {
        None => _ = ui.label("nothing"),
        Some(hit) => {
            ui.label(format!("material {}", hit.material));
            let [x, y, z] = hit.position.to_array();
            ui.label(format!("position {x:.4}, {y:.4}, {z:.4}"));
            if let Some(normal) = hit.normal {
                ui.label(format!("normal {:.3}, {:.3}, {:.3}", normal.x, normal.y, normal.z));
            }
            ui.label(format!("depth {:.4}", hit.depth));
        }
    }
    if let Some([r, g, b]) = picked.radiance {
        ui.label(format!("radiance {r:.4}, {g:.4}, {b:.4}"));
    }
    if picked.lights.is_empty() {
        ui.small("for the classes of the lights, show the overlay classes");
    }
    match &picked.nearest {
        Some(nearest) => {
            let [n_i, n_s] = nearest.counts();
            ui.label(format!("nearest photons of the selected light: n_i {n_i}, n_s {n_s}"));
        }
        None => _ = ui.small("for the nearest photons, show the overlay photons or cells"),
    }
    for light in &picked.lights {
        let [n_i, n_s] = light.photons;
        ui.label(format!(
            "{}: {}, visibility {:.3}, n_i {n_i:.1}, n_s {n_s:.1}",
            light.name, light.class, light.visibility
        ));
    }
}
