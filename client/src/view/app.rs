//! The window: its loop, its surface, the panel over the picture, files and the clipboard.

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Window, WindowId};

use super::feed::{Feed, Piece};
use super::input::Input;
use super::panel::{self, Facts, Wishes};
use super::surface::{Screen, no_window};
use super::viewer::Viewer;
use super::{Options, Subject};
use crate::error::{ClientError, Result};
use crate::passes::gpu::Gpu;
use crate::picture::write_png;

/// Weight of the last picture in the mean time of pictures.
const LAST_WEIGHT: f32 = 0.1;
/// Most pictures of a folder that F12 writes.
const PICTURES_MAX: u32 = 9_999;
/// Most pictures more than were asked for, until one is whole.
const FRAMES_MORE: u64 = 600;

/// Why there may be no display, and what to do.
const NO_DISPLAY: &str = "no display can be opened: start it in a desktop session, or set DISPLAY or WAYLAND_DISPLAY to \
one that is there; on Debian it takes libx11-6, libx11-xcb1, libxcursor1, libxi6 and libxkbcommon-x11-0 as well";

/// A piece of light has come.
#[derive(Debug)]
struct Woken;

/// Opens a window on a bake, until the user closes it.
pub fn run(subject: Subject, options: Options) -> Result<()> {
    let event_loop = open_loop()?;
    event_loop.set_control_flow(ControlFlow::Wait);
    let wake = event_loop.create_proxy();
    let mut app = App { start: Some((subject, options)), wake, running: None, outcome: Ok(()) };
    let ran = event_loop.run_app(&mut app);
    app.outcome?;
    ran.map_err(|error| no_window(error.to_string()))
}

/// The loop of a display. A library of the display that is missing may be a panic of the crate that loads it, which is caught.
fn open_loop() -> Result<EventLoop<Woken>> {
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|panic| tracing::debug!(%panic, "no display")));
    let opened = std::panic::catch_unwind(|| EventLoop::with_user_event().build());
    std::panic::set_hook(hook);
    let error = match opened {
        Ok(Ok(event_loop)) => return Ok(event_loop),
        Ok(Err(error)) => error.to_string(),
        Err(_) => "a library cannot be loaded".to_owned(),
    };
    // Its words name files of the build.
    tracing::debug!(error, "no display");
    Err(no_window(NO_DISPLAY.to_owned()))
}

struct App {
    start: Option<(Subject, Options)>,
    wake: EventLoopProxy<Woken>,
    running: Option<Running>,
    outcome: Result<()>,
}

impl App {
    /// Ends the loop where something is wrong, or asks for its end.
    fn follow(&mut self, event_loop: &ActiveEventLoop, done: Result<bool>) {
        match done {
            Ok(false) => {}
            Ok(true) => event_loop.exit(),
            Err(error) => {
                self.outcome = Err(error);
                event_loop.exit();
            }
        }
    }
}

impl ApplicationHandler<Woken> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        let Some((subject, options)) = self.start.take() else { return };
        match Running::open(event_loop, subject, options, self.wake.clone()) {
            Ok(running) => self.running = Some(running),
            Err(error) => self.follow(event_loop, Err(error)),
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        let done = match &event {
            WindowEvent::CloseRequested => running.finish().map(|()| true),
            WindowEvent::RedrawRequested => running.draw(),
            _ => {
                running.event(&event);
                Ok(false)
            }
        };
        self.follow(event_loop, done);
    }

    fn user_event(&mut self, _: &ActiveEventLoop, _: Woken) {
        self.running.iter().for_each(|running| running.screen.window.request_redraw());
    }

    fn new_events(&mut self, event_loop: &ActiveEventLoop, cause: winit::event::StartCause) {
        if let winit::event::StartCause::ResumeTimeReached { .. } = cause {
            event_loop.set_control_flow(ControlFlow::Wait);
            self.running.iter().for_each(|running| running.screen.window.request_redraw());
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let wanted = self.running.as_mut().and_then(|running| running.redraw_at.take());
        if let Some(at) = wanted {
            event_loop.set_control_flow(ControlFlow::WaitUntil(at));
        }
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        // The surface goes before the window's display does.
        self.running = None;
    }
}

/// An open window.
struct Running {
    viewer: Viewer,
    egui: egui_winit::State,
    painter: egui_wgpu::Renderer,
    feed: Option<Feed>,
    facts: Facts,
    options: Options,
    gpu: Arc<Gpu>,
    screen: Screen,
    drawn: u64,
    /// When the last picture was begun; none where the window has rested since.
    last: Option<Instant>,
    /// When egui wants another picture.
    redraw_at: Option<Instant>,
    clipboard: Option<arboard::Clipboard>,
}

impl Running {
    fn open(
        event_loop: &ActiveEventLoop,
        subject: Subject,
        options: Options,
        wake: EventLoopProxy<Woken>,
    ) -> Result<Self> {
        let view = &options.view;
        let attributes = Window::default_attributes()
            .with_title(format!("{} · Lightkiln", options.bake_words))
            .with_inner_size(PhysicalSize::new(view.width, view.height));
        let window = event_loop.create_window(attributes).map_err(|error| no_window(error.to_string()))?;
        let (gpu, screen) = Screen::open(Arc::new(window), view.adapter_bytes_max)?;
        let (mut viewer, feed) = opened(subject, &options, wake, (&gpu, screen.format()))?;
        viewer.is_panel_open = options.has_panel;
        options.errors.clone().map_or(Ok(()), |errors| viewer.show_errors(errors))?;
        let (ctx, id) = (egui::Context::default(), egui::ViewportId::ROOT);
        let most = Some(gpu.device.limits().max_texture_dimension_2d as usize);
        let scale = Some(screen.window.scale_factor() as f32);
        let egui = egui_winit::State::new(ctx, id, &*screen.window, scale, screen.window.theme(), most);
        let painter = egui_wgpu::Renderer::new(&gpu.device, screen.format(), Default::default());
        let facts = Facts { drawn_by: gpu.name.clone(), notes: options.notes.clone(), ..Facts::default() };
        screen.window.request_redraw();
        Ok(Self {
            viewer,
            egui,
            painter,
            feed,
            facts,
            options,
            gpu,
            screen,
            drawn: 0,
            last: None,
            redraw_at: None,
            clipboard: None,
        })
    }

    /// Takes an event that is not about the window itself.
    fn event(&mut self, event: &WindowEvent) {
        if let WindowEvent::Resized(size) = event {
            self.screen.resize(&self.gpu, *size);
        }
        let response = self.egui.on_window_event(&self.screen.window, event);
        let input = Input::of(event);
        let counts = |input: &Input| !response.consumed || input.ends() || matches!(input, Input::Pointer(_));
        let taken = input.filter(counts);
        if let Some(input) = taken {
            self.viewer.input(input);
        }
        if response.repaint || taken.is_some() || matches!(event, WindowEvent::Resized(_)) {
            self.screen.window.request_redraw();
        }
    }

    /// Draws a picture and the panel over it; whether it was the last.
    fn draw(&mut self) -> Result<bool> {
        self.gpu.check()?;
        self.hear()?;
        let (last, begun) = (self.last.take(), Instant::now());
        let Some(size) = self.screen.size() else { return Ok(false) };
        let seconds = last.map(|last| begun.duration_since(last).as_secs_f32());
        self.viewer.resize(size)?;
        let (wishes, mut output) = self.panel();
        let freed = self.upload(&mut output);
        // Rest is no flight, and no time of a picture.
        self.viewer.step(seconds.unwrap_or(0.0))?;
        if let Some(seconds) = seconds {
            self.facts.frame_ms += LAST_WEIGHT * (1e3 * seconds - self.facts.frame_ms);
        }
        if let Some(texture) = self.screen.next(&self.gpu)? {
            self.paint(&texture, output);
            self.screen.window.pre_present_notify();
            self.gpu.queue.present(texture);
            // Pictures of a part of the light are not those that are waited for.
            self.drawn += u64::from(self.feed.as_ref().is_none_or(Feed::is_served));
        }
        for id in freed {
            self.painter.free_texture(&id);
        }
        self.grant(wishes)?;
        if self.is_last() {
            return self.finish().map(|()| true);
        }
        if self.viewer.is_busy() || self.options.frames.is_some() {
            self.last = Some(begun);
            self.screen.window.request_redraw();
        }
        Ok(false)
    }

    /// All pictures that were asked for are drawn, and the last is whole: answers of the adapter come some pictures later.
    fn is_last(&self) -> bool {
        let Some(frames) = self.options.frames else { return false };
        let is_whole = !self.viewer.is_busy() || self.drawn >= frames.saturating_add(FRAMES_MORE);
        self.drawn >= frames && is_whole
    }

    /// Takes light that has come. A server that is lost is said, and the light that there is stays; but pictures that are counted
    /// are of all the light, and end there.
    fn hear(&mut self) -> Result<()> {
        let Some(feed) = &mut self.feed else { return Ok(()) };
        let shown = feed.streamed;
        let mut is_whole = false;
        match feed.next() {
            Ok(Some(Piece { bake, streamed })) => match self.viewer.set_bake(bake) {
                Err(ClientError::AdapterFull { problem }) => {
                    self.viewer.notice = Some(said_of_fall(&problem, feed.fall(shown)));
                }
                set => {
                    set?;
                    is_whole = streamed.is_whole();
                }
            },
            Ok(None) => {}
            Err(error) if self.options.frames.is_some() => return Err(error),
            Err(error) => {
                // Whether the bake goes on is not known any more.
                feed.streamed.baked = None;
                self.viewer.notice = Some(format!("no more light is fetched: {error}"));
            }
        }
        self.facts.streamed = Some(feed.streamed);
        feed.look(self.viewer.view());
        if feed.is_over() || is_whole {
            self.feed = None;
        }
        Ok(())
    }

    /// Runs the panel: the user's wishes, and what is to be painted.
    fn panel(&mut self) -> (Wishes, egui::FullOutput) {
        let input = self.egui.take_egui_input(&self.screen.window);
        let ctx = self.egui.egui_ctx().clone();
        let mut wishes = Wishes::default();
        let (viewer, facts) = (&mut self.viewer, &self.facts);
        let mut output = ctx.run_pass(input, |ctx| wishes = panel::show(ctx, viewer, facts));
        self.egui.handle_platform_output(&self.screen.window, std::mem::take(&mut output.platform_output));
        let delay = output.viewport_output.values().map(|viewport| viewport.repaint_delay).min();
        self.redraw_at =
            delay.filter(|delay| *delay < Duration::from_secs(3600)).map(|delay| Instant::now() + delay);
        (wishes, output)
    }

    fn paint(&mut self, texture: &wgpu::SurfaceTexture, output: egui::FullOutput) {
        let Gpu { device, queue, .. } = &*self.gpu;
        let triangles = self.egui.egui_ctx().tessellate(output.shapes, output.pixels_per_point);
        let size_in_pixels = [texture.texture.width(), texture.texture.height()];
        let screen =
            egui_wgpu::ScreenDescriptor { size_in_pixels, pixels_per_point: output.pixels_per_point };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.gpu.submit(|encoder| {
            self.viewer.present(encoder, &view);
            self.painter.update_buffers(device, queue, encoder, &triangles, &screen);
            let ops = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
            let attachment =
                wgpu::RenderPassColorAttachment { view: &view, depth_slice: None, resolve_target: None, ops };
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("panel"),
                color_attachments: &[Some(attachment)],
                ..Default::default()
            });
            self.painter.render(&mut pass.forget_lifetime(), &triangles, &screen);
        });
    }

    /// Uploads the panel's textures, whether or not there is a picture to paint them on.
    #[allow(clippy::iter_over_hash_type, reason = "textures know nothing of each other")]
    fn upload(&mut self, output: &mut egui::FullOutput) -> Vec<egui::TextureId> {
        let Gpu { device, queue, .. } = &*self.gpu;
        let mut textures = std::mem::take(&mut output.textures_delta);
        for (id, deltas) in &textures.set {
            for delta in deltas {
                self.painter.update_texture(device, queue, *id, delta);
            }
        }
        let freed = textures.free.iter().copied().collect();
        textures.clear();
        freed
    }

    /// Does what the panel or a key asked for. A file or a clipboard that fails is said in the panel.
    fn grant(&mut self, wishes: Wishes) -> Result<()> {
        if wishes.copies {
            let (command, notes) = self.viewer.command(&self.options.bake_words);
            let printed = writeln!(std::io::stdout(), "{command}");
            let said = match (self.copy(command), printed) {
                (Ok(()), Ok(())) => "copied, and printed".to_owned(),
                (Ok(()), Err(error)) => format!("copied; not printed ({error})"),
                (Err(error), Ok(())) => format!("printed on standard output; not copied ({error})"),
                (Err(copied), Err(printed)) => format!("not copied ({copied}), and not printed ({printed})"),
            };
            self.viewer.notice = Some([vec![said], notes].concat().join("; "));
        }
        if wishes.picture || std::mem::take(&mut self.viewer.wants_picture) {
            let path = unused_picture();
            self.viewer.notice = Some(match self.write(&path) {
                Ok(()) => format!("{} is written", path.display()),
                Err(error @ (ClientError::File { .. } | ClientError::Picture { .. })) => error.to_string(),
                Err(error) => return Err(error),
            });
        }
        Ok(())
    }

    /// The clipboard stays open: on X11 its text is the window's to give.
    fn copy(&mut self, text: String) -> std::result::Result<(), arboard::Error> {
        let clipboard = match self.clipboard.take() {
            Some(clipboard) => clipboard,
            None => arboard::Clipboard::new()?,
        };
        self.clipboard.insert(clipboard).set_text(text)
    }

    fn write(&self, path: &std::path::Path) -> Result<()> {
        let [width, height] = self.viewer.size();
        write_png(path, width, height, &self.viewer.picture()?)
    }

    /// Writes the last picture where that was asked for.
    fn finish(&self) -> Result<()> {
        self.options.screenshot.as_ref().map_or(Ok(()), |path| self.write(path))
    }
}

/// A viewer of the bake, and the feed of more of its light. A bake that the adapter has no room for is shown with less light.
fn opened(
    subject: Subject,
    options: &Options,
    wake: EventLoopProxy<Woken>,
    (gpu, format): (&Arc<Gpu>, wgpu::TextureFormat),
) -> Result<(Viewer, Option<Feed>)> {
    let shown = |bake| Viewer::new((Arc::clone(gpu), format), bake, options.view.clone(), &options.materials);
    let fed = |stream, memory| {
        // A loop that has ended needs no waking.
        let wake = move || drop(wake.send_event(Woken));
        let (feed, bake) = Feed::start(stream, memory, options.view.clone(), wake);
        Ok((shown(bake)?, Some(feed)))
    };
    let (bake, less) = match subject {
        Subject::Whole(bake, less) => (bake, less),
        Subject::Streamed(stream) => return fed(*stream, options.memory),
    };
    let problem = match shown(Arc::new(*bake)) {
        Err(ClientError::AdapterFull { problem }) => problem,
        viewer => return Ok((viewer?, None)),
    };
    // A kind whose light does not come in pieces has no less of it.
    let Ok(stream) = less() else { return Err(ClientError::AdapterFull { problem }) };
    gpu.let_go()?;
    let memory = stream.less_memory(u64::MAX).unwrap_or(0);
    let said = said_of_fall(&problem, memory);
    let (mut viewer, feed) = fed(stream, memory)?;
    viewer.notice = Some(said);
    Ok((viewer, feed))
}

/// Says, and logs, that the adapter has no room for more light than so many bytes of it.
fn said_of_fall(problem: &str, memory: u64) -> String {
    let said = format!(
        "less light is shown, at most {:.1} MB of it, as the adapter has no room for more: {problem}",
        memory as f64 / 1e6
    );
    tracing::warn!("{said}");
    said
}

/// The first numbered file that is not there.
fn unused_picture() -> PathBuf {
    let file = |number: u32| PathBuf::from(format!("kiln-{number:04}.png"));
    (1..PICTURES_MAX).map(file).find(|path| !path.exists()).unwrap_or_else(|| file(PICTURES_MAX))
}
