//! The window's surface: configured, lost, and found again.

use std::sync::Arc;

use winit::dpi::PhysicalSize;
use winit::window::Window;

use crate::error::{ClientError, Result};
use crate::passes::gpu::Gpu;

/// A window with its surface.
pub struct Screen {
    /// The window.
    pub window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    /// It has a size other than 0, and was configured with it.
    is_ready: bool,
}

impl Screen {
    /// The window's surface on the best adapter that draws to it, to take at most so many bytes of its memory.
    pub fn open(window: Arc<Window>, bytes_max: Option<u64>) -> Result<(Arc<Gpu>, Self)> {
        let opened = Gpu::open_for(Arc::clone(&window), bytes_max).map_err(|error| match error {
            ClientError::Adapter { problem } => no_window(problem),
            error => error,
        });
        let (gpu, surface) = opened?;
        let can = gpu.surface_capabilities(&surface);
        // Numbers as they are: egui and the show pass encode sRGB themselves.
        let plain = |format: &&wgpu::TextureFormat| {
            matches!(format, wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Rgba8Unorm)
        };
        let Some(format) = can.formats.iter().find(plain).or(can.formats.first()).copied() else {
            return Err(no_window(format!("{} draws to no window of this display", gpu.name)));
        };
        let config = wgpu::SurfaceConfiguration {
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            format,
            color_space: wgpu::SurfaceColorSpace::Auto,
            width: 0,
            height: 0,
            present_mode: wgpu::PresentMode::AutoVsync,
            desired_maximum_frame_latency: 1,
            alpha_mode: wgpu::CompositeAlphaMode::Auto,
            view_formats: Vec::new(),
        };
        let mut screen = Self { window, surface, config, is_ready: false };
        screen.resize(&gpu, screen.window.inner_size());
        Ok((Arc::new(gpu), screen))
    }

    /// Format of its pictures.
    pub fn format(&self) -> wgpu::TextureFormat {
        self.config.format
    }

    /// Width and height in pixels; none while the window has none, as when it is minimised.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.is_ready.then_some([self.config.width, self.config.height])
    }

    /// Takes the window's size.
    pub fn resize(&mut self, gpu: &Gpu, size: PhysicalSize<u32>) {
        let most = gpu.device.limits().max_texture_dimension_2d;
        self.is_ready = size.width > 0 && size.height > 0;
        if self.is_ready {
            (self.config.width, self.config.height) = (size.width.min(most), size.height.min(most));
            self.surface.configure(&gpu.device, &self.config);
        }
    }

    /// The next picture to draw to; none where there is none at the moment. A surface that is out of date is configured anew, and one
    /// that is lost made anew.
    pub fn next(&mut self, gpu: &Gpu) -> Result<Option<wgpu::SurfaceTexture>> {
        use wgpu::CurrentSurfaceTexture as Current;
        if !self.is_ready {
            return Ok(None);
        }
        match self.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => return Ok(Some(texture)),
            Current::Timeout | Current::Occluded | Current::Validation => return Ok(None),
            Current::Lost => self.surface = gpu.surface(Arc::clone(&self.window))?,
            Current::Outdated => {}
        }
        self.resize(gpu, self.window.inner_size());
        self.window.request_redraw();
        Ok(None)
    }
}

/// An error that says why there is no window, and what to do.
pub fn no_window(problem: String) -> ClientError {
    ClientError::Window { problem }
}
