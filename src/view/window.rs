//! The window: events of the system, and the panel on the device that renders.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use egui::{Context, ViewportId};
use kernel_kit::{DeviceChoice, DeviceLimits, Gpu};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Window, WindowId};

use super::panel::{self, Panel, Request};
use super::session::{Choices, Command, Snapshot, Source, State};
use super::worker::{Event, Worker};
use crate::scene::Scene;
use crate::{Error, Result};

/// Size of the picture in points, if the command gives none.
const SIZE: [f64; 2] = [960.0, 600.0];

/// The inputs of the window.
pub struct Program {
    /// The options of the command.
    pub source: Arc<dyn Source>,
    /// The scene's file.
    pub file: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// What is shown at first.
    pub choices: Choices,
    /// Whether the picture has the size of the window, and not that of the settings.
    pub follows_window: bool,
    /// The device.
    pub device: (DeviceChoice, DeviceLimits),
    /// The folder that keeps composed kernels.
    pub kernels: Option<PathBuf>,
    /// Gets each command that is copied.
    pub copied: Box<dyn Fn(&str)>,
}

/// A connection to the display.
pub struct Display(EventLoop<Event>);

impl Display {
    /// Connects.
    ///
    /// # Errors
    /// [`Error::NoDisplay`].
    pub fn open() -> Result<Display> {
        let opened = EventLoop::with_user_event().build();
        Ok(Display(opened.map_err(|problem| Error::NoDisplay(one_line(&problem.to_string())))?))
    }

    /// Opens the window, and returns once it is closed.
    ///
    /// # Errors
    /// [`Error::NoDisplay`] if no window can be opened, [`Error::NoDevice`] if the device cannot show one, and
    /// [`Error::DeviceLost`] if there is no other device after a loss.
    pub fn show(self, program: Program) -> Result<()> {
        let Display(events) = self;
        let mut application =
            Application { proxy: events.create_proxy(), program: Some(program), view: None, outcome: Ok(()) };
        events.set_control_flow(ControlFlow::Wait);
        let ended = events.run_app(&mut application).map_err(|problem| Error::NoDisplay(problem.to_string()));
        application.outcome.and(ended)
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

struct Application {
    proxy: EventLoopProxy<Event>,
    /// Until the window is open.
    program: Option<Program>,
    view: Option<View>,
    outcome: Result<()>,
}

impl Application {
    fn end(&mut self, events: &ActiveEventLoop, outcome: Result<()>) {
        // The thread ends before the window, which may take it some seconds.
        if let Some(view) = &self.view {
            view.window.set_visible(false);
        }
        self.view = None;
        self.outcome = outcome;
        events.exit();
    }

    fn attempt(&mut self, events: &ActiveEventLoop, work: impl FnOnce(&mut View) -> Result<bool>) {
        match self.view.as_mut().map(work) {
            Some(Ok(true)) | None => {}
            Some(Ok(false)) => self.end(events, Ok(())),
            Some(Err(problem)) => self.end(events, Err(problem)),
        }
    }
}

impl ApplicationHandler<Event> for Application {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        let Some(program) = self.program.take() else { return };
        match View::open(events, program, self.proxy.clone()) {
            Ok(view) => self.view = Some(view),
            Err(problem) => self.end(events, Err(problem)),
        }
    }

    fn user_event(&mut self, events: &ActiveEventLoop, event: Event) {
        self.attempt(events, |view| view.handle_event(event).map(|()| true));
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        self.attempt(events, |view| view.event(&event));
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        let Some(view) = &self.view else { return };
        match view.repaint_at {
            Some(at) if at <= Instant::now() => view.window.request_redraw(),
            Some(at) => return events.set_control_flow(ControlFlow::WaitUntil(at)),
            None => {}
        }
        events.set_control_flow(ControlFlow::Wait);
    }
}

/// The open window.
struct View {
    // Dropped first: the thread renders on the device.
    worker: Worker,
    surface: Surface,
    egui: egui_winit::State,
    context: Context,
    panel: Panel,
    snapshot: Option<Snapshot>,
    source: Arc<dyn Source>,
    copied: Box<dyn Fn(&str)>,
    /// When the panel wants to be drawn again.
    repaint_at: Option<Instant>,
    window: Arc<Window>,
}

impl View {
    fn open(events: &ActiveEventLoop, program: Program, proxy: EventLoopProxy<Event>) -> Result<View> {
        let Program { source, file, scene, choices, follows_window, device, kernels, copied } = program;
        let image = &choices.settings.image;
        let [width, height] = if follows_window { SIZE } else { [image.width, image.height].map(f64::from) };
        let attributes = Window::default_attributes()
            .with_title(format!("{} - Penumbra", file.display()))
            .with_inner_size(LogicalSize::new(width + f64::from(panel::WIDTH), height));
        let no_window = |problem: String| Error::NoDisplay(one_line(&problem));
        let window = Arc::new(events.create_window(attributes).map_err(|problem| no_window(problem.to_string()))?);
        let instance = kernel_kit::instance();
        let surface = instance.create_surface(window.clone()).map_err(|problem| no_window(problem.to_string()))?;
        let (choice, limits) = device;
        let open = {
            let instance = instance.clone();
            move || -> Result<Arc<Gpu>> {
                let gpu = Gpu::open_in(&instance, &choice, limits)?;
                if let Some(folder) = &kernels {
                    gpu.keep_composed(folder);
                }
                Ok(Arc::new(gpu))
            }
        };
        let gpu = open()?;
        let size = window.inner_size();
        let surface = Surface::new(surface, gpu.clone(), [size.width, size.height])?;
        let context = Context::default();
        let max_side = gpu.device.limits().max_texture_dimension_2d as usize;
        let scale = Some(window.scale_factor() as f32);
        let egui = egui_winit::State::new(context.clone(), ViewportId::ROOT, &window, scale, None, Some(max_side));
        let tell = move |event| {
            // The window may be closed already.
            let _ = proxy.send_event(event);
        };
        let state = State::new(source.clone(), file, scene, choices);
        let worker = Worker::start(gpu, state, open, tell);
        let panel = Panel::new(follows_window);
        window.request_redraw();
        Ok(View { worker, surface, egui, context, panel, snapshot: None, source, copied, repaint_at: None, window })
    }

    /// Handles an event of the worker.
    fn handle_event(&mut self, event: Event) -> Result<()> {
        match event {
            Event::Picture => {
                let Some(snapshot) = self.worker.take() else { return Ok(()) };
                let name = snapshot.picture.file.display();
                self.window.set_title(&format!("{name} - Penumbra"));
                self.snapshot = Some(snapshot);
            }
            Event::Compiling(compilation) => self.panel.compiling(compilation),
            Event::Device(gpu) => {
                self.surface.set_device(gpu)?;
                // The context uploads its fonts again.
                self.context = Context::default();
                let scale = Some(self.window.scale_factor() as f32);
                let side = self.surface.gpu.device.limits().max_texture_dimension_2d as usize;
                let root = ViewportId::ROOT;
                self.egui = egui_winit::State::new(self.context.clone(), root, &self.window, scale, None, Some(side));
                self.panel.forget_device();
            }
            Event::Failed(problem) => return Err(problem),
        }
        self.window.request_redraw();
        Ok(())
    }

    /// Handles an event of the window. Returns whether it stays open.
    fn event(&mut self, event: &WindowEvent) -> Result<bool> {
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => return Ok(false),
            WindowEvent::Resized(size) => self.surface.resized = Some([size.width, size.height]),
            WindowEvent::DroppedFile(file) => self.worker.send(Command::Open(file.clone())),
            WindowEvent::RedrawRequested => return self.draw(),
            _ => {}
        }
        if self.egui.on_window_event(&self.window, event).repaint {
            self.window.request_redraw();
        }
        Ok(true)
    }

    /// Draws the window. Returns whether it stays open.
    fn draw(&mut self) -> Result<bool> {
        self.repaint_at = None;
        let input = self.egui.take_egui_input(&self.window);
        let mut requests = Vec::new();
        let (panel, snapshot) = (&mut self.panel, &self.snapshot);
        let output = self.context.run_ui(input, |ui| match snapshot {
            Some(snapshot) => requests.extend(panel.show(ui, snapshot)),
            None => requests.extend(panel.wait(ui).then_some(Request::Quit)),
        });
        self.egui.handle_platform_output(&self.window, output.platform_output);
        let delay = output.viewport_output.values().map(|viewport| viewport.repaint_delay).min();
        let soon = delay.filter(|delay| *delay < Duration::from_secs(3600));
        self.repaint_at = soon.map(|delay| Instant::now() + delay);
        let pixels_per_point = output.pixels_per_point;
        let primitives = self.context.tessellate(output.shapes, pixels_per_point);
        self.surface.draw(&primitives, output.textures_delta, pixels_per_point, &self.window);
        for request in requests {
            match request {
                Request::Command(command) => self.worker.send(command),
                Request::Copy => self.copy(),
                Request::Quit => return Ok(false),
            }
        }
        Ok(true)
    }

    fn copy(&mut self) {
        let Some(snapshot) = &self.snapshot else { return };
        let command = self.source.command(&snapshot.picture, &snapshot.cameras);
        (self.copied)(&command);
        self.context.copy_text(command.clone());
        self.panel.copied(command);
        self.window.request_redraw();
    }
}

/// The surface that the window is drawn on.
struct Surface {
    surface: wgpu::Surface<'static>,
    gpu: Arc<Gpu>,
    painter: egui_wgpu::Renderer,
    /// `None` while the window has no size.
    config: Option<wgpu::SurfaceConfiguration>,
    format: wgpu::TextureFormat,
    /// A new size, until the next drawing: a window that is dragged has many, and each configuration waits for all
    /// submitted work.
    resized: Option<[u32; 2]>,
}

impl Surface {
    fn new(surface: wgpu::Surface<'static>, gpu: Arc<Gpu>, size: [u32; 2]) -> Result<Surface> {
        let format = format(&surface, &gpu)?;
        let painter = painter(&gpu, format);
        let mut surface = Surface { surface, gpu, painter, config: None, format, resized: None };
        surface.resize(size);
        Ok(surface)
    }

    fn set_device(&mut self, gpu: Arc<Gpu>) -> Result<()> {
        self.format = format(&self.surface, &gpu)?;
        self.painter = painter(&gpu, self.format);
        self.gpu = gpu;
        if let Some(config) = &self.config {
            let size = [config.width, config.height];
            self.resize(size);
        }
        Ok(())
    }

    fn resize(&mut self, [width, height]: [u32; 2]) {
        if width == 0 || height == 0 {
            self.config = None;
            return;
        }
        let max = self.gpu.device.limits().max_texture_dimension_2d;
        let config = wgpu::SurfaceConfiguration {
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            format: self.format,
            color_space: Default::default(),
            width: width.min(max),
            height: height.min(max),
            // Every device has it, and it tears nothing.
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 2,
            alpha_mode: wgpu::CompositeAlphaMode::Auto,
            view_formats: Vec::new(),
        };
        self.gpu.configure(&self.surface, &config);
        self.config = Some(config);
    }

    fn draw(
        &mut self,
        primitives: &[egui::ClippedPrimitive],
        mut textures: egui::TexturesDelta,
        pixels_per_point: f32,
        window: &Window,
    ) {
        if let Some(size) = self.resized.take() {
            self.resize(size);
        }
        let Gpu { device, queue, .. } = &*self.gpu;
        for (id, deltas) in textures.set.drain() {
            for delta in &deltas {
                self.painter.update_texture(device, queue, id, delta);
            }
        }
        let freed: Vec<_> = textures.free.drain().collect();
        if let Some(config) = &self.config {
            let frame = match self.surface.get_current_texture() {
                wgpu::CurrentSurfaceTexture::Success(frame) => Some(frame),
                wgpu::CurrentSurfaceTexture::Suboptimal(frame) => Some(frame),
                // The size is old, or the display was away: again, with what the window has now.
                wgpu::CurrentSurfaceTexture::Outdated | wgpu::CurrentSurfaceTexture::Lost => {
                    self.gpu.configure(&self.surface, config);
                    window.request_redraw();
                    None
                }
                // Nobody sees it. Events draw it again.
                _ => None,
            };
            if let Some(frame) = frame {
                let screen =
                    egui_wgpu::ScreenDescriptor { size_in_pixels: [config.width, config.height], pixels_per_point };
                self.paint(&frame, primitives, &screen);
                window.pre_present_notify();
                self.gpu.queue.present(frame);
            }
        }
        freed.iter().for_each(|id| self.painter.free_texture(id));
    }

    fn paint(
        &mut self,
        frame: &wgpu::SurfaceTexture,
        primitives: &[egui::ClippedPrimitive],
        screen: &egui_wgpu::ScreenDescriptor,
    ) {
        let Gpu { device, queue, .. } = &*self.gpu;
        let view = frame.texture.create_view(&Default::default());
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("window") });
        let more = self.painter.update_buffers(device, queue, &mut encoder, primitives, screen);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("window"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        self.painter.render(&mut pass.forget_lifetime(), primitives, screen);
        self.gpu.submit(more.into_iter().chain([encoder.finish()]));
    }
}

fn painter(gpu: &Gpu, format: wgpu::TextureFormat) -> egui_wgpu::Renderer {
    // Without dithering, a pixel on the screen has the colour of the file.
    let options = egui_wgpu::RendererOptions { dithering: false, ..Default::default() };
    egui_wgpu::Renderer::new(&gpu.device, format, options)
}

/// A format that does not apply the sRGB transfer function, which the pixels have already.
fn format(surface: &wgpu::Surface<'_>, gpu: &Gpu) -> Result<wgpu::TextureFormat> {
    let formats = gpu.surface_formats(surface);
    let format = formats.iter().find(|format| !format.is_srgb()).or(formats.first());
    let problem = || Error::NoDevice(format!("{} cannot display in a window; choose another device", gpu.info.name));
    format.copied().ok_or_else(problem)
}
