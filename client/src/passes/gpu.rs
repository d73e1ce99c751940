//! The graphics adapter: opening it, buffers within its limits, pipelines, reading back.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytemuck::Pod;
use wgpu::{BufferUsages as Usage, ShaderStages as Stages};

use super::overheard::logged;
use super::room::{Faults, bytes_of, full};
use crate::error::{ClientError, Result};

/// Longest wait for the adapter to finish its work.
const PATIENCE: Duration = Duration::from_secs(300);
/// Smallest buffer: bindings must hold at least one element, and none of ours is larger.
const SMALLEST_BUFFER: u64 = 256;
/// Most bytes of one storage binding that are asked for, where an adapter has more than the 128 MiB of all: arrays by receiver are not
/// split into pages, and have 16 bytes for each of up to [`lightkiln_proto::relight::MAX_RECEIVERS`].
const BINDING_MAX: u64 = 1 << 30;

/// An open adapter.
#[derive(Debug)]
pub struct Gpu {
    /// Device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Name and kind, for people.
    pub name: String,
    /// Whether it is a program that runs on the processor.
    pub software: bool,
    /// Most bytes of one storage binding; larger arrays are split into pages.
    pub binding_max: u64,
    /// Most bytes of its memory that buffers and textures take together; as many as there are without.
    pub(super) bytes_max: Option<u64>,
    /// None where another program opened it.
    opened: Option<Opened>,
    faults: Arc<Mutex<Faults>>,
    created: AtomicU64,
    stored: AtomicU64,
}

/// Where an adapter that is ours came from.
#[derive(Debug)]
struct Opened {
    instance: wgpu::Instance,
    adapter: wgpu::Adapter,
}

impl Gpu {
    /// Opens the best adapter there is.
    pub fn open() -> Result<Self> {
        Self::open_within(None)
    }

    /// Opens the best adapter there is, to take at most so many bytes of its memory.
    pub fn open_within(bytes_max: Option<u64>) -> Result<Self> {
        logged(|| pollster::block_on(Self::open_async()))?.bounded(bytes_max)
    }

    async fn open_async() -> Result<Self> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        Self::open_on(&instance, None).await
    }

    /// Opens the best adapter that draws to a window, with the window's surface, to take at most so many bytes of its memory.
    pub fn open_for(
        window: impl Into<wgpu::SurfaceTarget<'static>>,
        bytes_max: Option<u64>,
    ) -> Result<(Self, wgpu::Surface<'static>)> {
        logged(|| {
            let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
            let surface = instance.create_surface(window).map_err(|error| {
                tracing::debug!(%error, "no surface");
                failed("Vulkan finds no graphics adapter that draws to a window".to_owned())
            })?;
            let gpu = pollster::block_on(Self::open_on(&instance, Some(&surface)))?;
            Ok((gpu.bounded(bytes_max)?, surface))
        })
    }

    /// Another surface for a window whose own is lost.
    pub fn surface(&self, window: impl Into<wgpu::SurfaceTarget<'static>>) -> Result<wgpu::Surface<'static>> {
        let Some(Opened { instance, .. }) = &self.opened else {
            return Err(failed(format!(
                "{} belongs to another program, whose surfaces are its own",
                self.name
            )));
        };
        let made = instance.create_surface(window);
        made.map_err(|error| failed(format!("{} makes no surface for the window ({error})", self.name)))
    }

    async fn open_on(instance: &wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = instance.request_adapter(&options).await.map_err(|error| {
            tracing::debug!(%error, "no adapter");
            failed("Vulkan finds no graphics adapter".to_owned())
        })?;
        let has = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: has.max_buffer_size,
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size.min(BINDING_MAX),
            max_texture_dimension_2d: has.max_texture_dimension_2d,
            ..Self::required_limits()
        };
        let required_features = adapter.features() & Self::wanted_features();
        let descriptor =
            wgpu::DeviceDescriptor { required_limits: limits, required_features, ..Default::default() };
        let described = adapter.get_info();
        let (device, queue) = adapter
            .request_device(&descriptor)
            .await
            .map_err(|error| failed(format!("{} cannot be used ({error})", described.name)))?;
        let gpu = Self::new(device, queue, &described);
        let heard = Arc::clone(&gpu.faults);
        gpu.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            heard.lock().unwrap_or_else(PoisonError::into_inner).hear(&error);
        }));
        let lost = Arc::clone(&gpu.faults);
        gpu.device.set_device_lost_callback(move |_, message| {
            lost.lock().unwrap_or_else(PoisonError::into_inner).lose(&message);
        });
        let opened = Opened { instance: instance.clone(), adapter };
        Ok(Self { opened: Some(opened), ..gpu })
    }

    /// Limits that a device must have for a bake to be lit on it.
    pub fn required_limits() -> wgpu::Limits {
        wgpu::Limits::default()
    }

    /// Features that are used where a device has them: glass is blended over 32-bit radiance, passes are timed.
    pub fn wanted_features() -> wgpu::Features {
        wgpu::Features::FLOAT32_BLENDABLE | wgpu::Features::TIMESTAMP_QUERY
    }

    /// Shares the device of another program in this process, whose adapter is `described`. Errs where it has less than
    /// [`Gpu::required_limits`]. Uncaptured errors stay with whoever made the device: [`Gpu::check`] hears of none.
    pub fn share(device: wgpu::Device, queue: wgpu::Queue, described: &wgpu::AdapterInfo) -> Result<Self> {
        let mut lacking = Vec::new();
        Self::required_limits().check_limits_with_fail_fn(&device.limits(), false, |name, wanted, has| {
            lacking.push(format!("{name} {has}, wanted {wanted}"));
        });
        if lacking.is_empty() {
            return Ok(Self::new(device, queue, described));
        }
        Err(failed(format!("the device of {} has too low limits: {}", described.name, lacking.join("; "))))
    }

    fn new(device: wgpu::Device, queue: wgpu::Queue, described: &wgpu::AdapterInfo) -> Self {
        let name = format!("{} ({:?}, {:?})", described.name, described.device_type, described.backend);
        let software = described.device_type == wgpu::DeviceType::Cpu;
        let [created, stored] = [0, 0].map(AtomicU64::new);
        let faults = Arc::default();
        let limits = device.limits();
        let binding_max = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(BINDING_MAX);
        let (opened, bytes_max) = (None, None);
        Self { device, queue, name, software, binding_max, bytes_max, opened, faults, created, stored }
    }

    /// Abilities of a window's surface on this adapter.
    pub fn surface_capabilities(&self, surface: &wgpu::Surface<'_>) -> wgpu::SurfaceCapabilities {
        let opened = self.opened.as_ref();
        opened.map(|opened| surface.get_capabilities(&opened.adapter)).unwrap_or_default()
    }

    /// The first thing that went wrong since the last call, if anything did; of a device that is lost, its loss each time.
    pub fn check(&self) -> Result<()> {
        self.faults().take(&self.name)
    }

    fn faults(&self) -> MutexGuard<'_, Faults> {
        self.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Buffers, textures, samplers, bind groups, shaders and pipelines made so far.
    pub fn created(&self) -> u64 {
        self.created.load(Ordering::Relaxed)
    }

    /// Bytes of the storage buffers made so far: those of light are, those of meshes are none.
    pub fn stored(&self) -> u64 {
        self.stored.load(Ordering::Relaxed)
    }

    fn count(&self) -> &wgpu::Device {
        self.created.fetch_add(1, Ordering::Relaxed);
        &self.device
    }

    /// A storage buffer that holds `values`; larger than one binding is an error.
    pub fn storage<T: Pod>(&self, label: &str, values: &[T]) -> Result<wgpu::Buffer> {
        let buffer = self.blank(label, size_of_val(values) as u64)?;
        self.write(&buffer, values);
        Ok(buffer)
    }

    /// A storage buffer of zeros; larger than one binding is an error.
    pub fn blank(&self, label: &str, bytes: u64) -> Result<wgpu::Buffer> {
        if bytes > self.binding_max {
            return Err(full(format!(
                "{label} takes {bytes} bytes, {} binds {}; a bake of fewer receivers (--set texel_m=…) takes less",
                self.name, self.binding_max
            )));
        }
        self.stored.fetch_add(bytes, Ordering::Relaxed);
        self.array(label, bytes, Usage::STORAGE | Usage::COPY_SRC)
    }

    /// A uniform buffer.
    pub fn uniform<T: Pod>(&self, label: &str, value: &T) -> wgpu::Buffer {
        let buffer = self.buffer(label, size_of::<T>() as u64, Usage::UNIFORM);
        self.write(&buffer, std::slice::from_ref(value));
        buffer
    }

    /// A uniform buffer of many values, one every `stride` bytes, for dynamic offsets.
    pub fn uniforms<T: Pod>(&self, label: &str, values: &[T]) -> (wgpu::Buffer, u32) {
        let alignment = self.device.limits().min_uniform_buffer_offset_alignment as usize;
        let stride = size_of::<T>().next_multiple_of(alignment.max(1));
        let buffer = self.buffer(label, (stride * values.len().max(1)) as u64, Usage::UNIFORM);
        self.write_strided(&buffer, values, stride as u32);
        (buffer, stride as u32)
    }

    /// Overwrites the first values of a buffer of [`Gpu::uniforms`].
    pub fn write_strided<T: Pod>(&self, buffer: &wgpu::Buffer, values: &[T], stride: u32) {
        let mut bytes = vec![0_u8; stride as usize * values.len()];
        for (slot, value) in bytes.chunks_mut(stride as usize).zip(values) {
            slot[..size_of::<T>()].copy_from_slice(bytemuck::bytes_of(value));
        }
        self.write(buffer, &bytes);
    }

    /// A small buffer that can also be written.
    pub fn buffer(&self, label: &str, bytes: u64, usage: Usage) -> wgpu::Buffer {
        self.count().create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(4).max(SMALLEST_BUFFER),
            usage: usage | Usage::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Overwrites the start of a buffer; element sizes are multiples of 4 bytes.
    pub fn write<T: Pod>(&self, buffer: &wgpu::Buffer, values: &[T]) {
        self.queue.write_buffer(buffer, 0, bytemuck::cast_slice(values));
    }

    /// Runs the commands that `record` records.
    pub fn submit(&self, record: impl FnOnce(&mut wgpu::CommandEncoder)) {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        record(&mut encoder);
        self.queue.submit([encoder.finish()]);
    }

    /// The first `count` values of a buffer, after everything submitted has run.
    pub fn read<T: Pod>(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 {
            return self.check().map(|()| Vec::new());
        }
        let landing = self.array("read back", bytes, Usage::MAP_READ)?;
        self.submit(|encoder| encoder.copy_buffer_to_buffer(buffer, 0, &landing, 0, bytes));
        let mut values = self.mapped(&landing)?;
        values.truncate(count);
        Ok(values)
    }

    /// One layer of a texture of 2-, 4- (depth) or 16-byte texels, row after row.
    pub fn read_layer<T: Pod>(
        &self,
        texture: &wgpu::Texture,
        layer: u32,
        aspect: wgpu::TextureAspect,
    ) -> Result<Vec<T>> {
        let (width, height) = (texture.width(), texture.height());
        let row = width as usize * size_of::<T>();
        let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
        let landing = self.array("read back", (padded * height as usize) as u64, Usage::MAP_READ)?;
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(padded as u32),
            rows_per_image: Some(height),
        };
        let origin = wgpu::Origin3d { x: 0, y: 0, z: layer };
        self.submit(|encoder| {
            encoder.copy_texture_to_buffer(
                wgpu::TexelCopyTextureInfo { texture, mip_level: 0, origin, aspect },
                wgpu::TexelCopyBufferInfo { buffer: &landing, layout },
                wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            );
        });
        let bytes: Vec<u8> = self.mapped(&landing)?;
        let rows = bytes.chunks_exact(padded).take(height as usize);
        Ok(rows.flat_map(|padded| bytemuck::pod_collect_to_vec::<u8, T>(&padded[..row])).collect())
    }

    /// Hears what the adapter has done so far, or after a wait for all of it.
    pub fn poll(&self, waits: bool) -> Result<()> {
        let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(PATIENCE) };
        let poll = || self.device.poll(if waits { wait } else { wgpu::PollType::Poll });
        if self.faults().is_lost() {
            return self.check();
        }
        // A device that is lost while one waits for it is a panic of wgpu.
        let polled = catch_unwind(AssertUnwindSafe(poll));
        if polled.is_err() {
            self.faults().lose("its driver stopped while it was waited for");
        }
        self.check()?;
        polled
            .unwrap_or(Err(wgpu::PollError::Timeout))
            .map(|_| ())
            .map_err(|error| failed(format!("{} does not answer ({error})", self.name)))
    }

    fn mapped<T: Pod>(&self, landing: &wgpu::Buffer) -> Result<Vec<T>> {
        let (sender, receiver) = mpsc::channel();
        landing.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone only when this call has given up.
            let _ = sender.send(result);
        });
        self.poll(true)?;
        match receiver.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            _ => return Err(failed(format!("{} gave nothing back", self.name))),
        }
        let view = landing
            .get_mapped_range(..)
            .map_err(|error| failed(format!("{} gave nothing back ({error})", self.name)))?;
        Ok(bytemuck::pod_collect_to_vec(&view))
    }

    /// A compute pipeline whose layout is the shader's.
    pub fn compute(&self, label: &str, source: &str, entry: &str) -> wgpu::ComputePipeline {
        self.compute_with((label, source, entry), None, &[])
    }

    /// A compute pipeline with a given layout, if any, and given values of overrides.
    pub fn compute_with(
        &self,
        (label, source, entry): (&str, &str, &str),
        layout: Option<&wgpu::PipelineLayout>,
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        self.count().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout,
            module: &self.module(label, source),
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        })
    }

    /// Marks of time; none where the adapter sets none at passes.
    pub fn queries(&self, count: u32) -> Option<wgpu::QuerySet> {
        let has_clock = self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let descriptor =
            wgpu::QuerySetDescriptor { label: Some("times"), ty: wgpu::QueryType::Timestamp, count };
        has_clock.then(|| self.count().create_query_set(&descriptor))
    }

    /// A render pipeline.
    pub fn render_pipeline(&self, descriptor: &wgpu::RenderPipelineDescriptor<'_>) -> wgpu::RenderPipeline {
        self.count().create_render_pipeline(descriptor)
    }

    /// A texture; errs where the adapter has no room for it.
    pub fn texture(&self, descriptor: &wgpu::TextureDescriptor<'_>) -> Result<wgpu::Texture> {
        let label = descriptor.label.unwrap_or("a texture");
        self.within(label, bytes_of(descriptor), || self.count().create_texture(descriptor))
    }

    /// A sampler.
    pub fn sampler(&self, descriptor: &wgpu::SamplerDescriptor<'_>) -> wgpu::Sampler {
        self.count().create_sampler(descriptor)
    }

    /// A shader module.
    pub fn module(&self, label: &str, source: &str) -> wgpu::ShaderModule {
        let source = wgpu::ShaderSource::Wgsl(source.into());
        self.count().create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
    }

    /// A bind group with `resources` at bindings 0, 1, ….
    pub fn bind(
        &self,
        layout: &wgpu::BindGroupLayout,
        resources: &[wgpu::BindingResource<'_>],
    ) -> wgpu::BindGroup {
        let numbered = resources.iter().enumerate();
        let numbered: Vec<_> =
            numbered.map(|(binding, resource)| (binding as u32, resource.clone())).collect();
        self.bind_at(layout, &numbered)
    }

    /// A bind group with each resource at its own binding.
    pub fn bind_at(
        &self,
        layout: &wgpu::BindGroupLayout,
        resources: &[(u32, wgpu::BindingResource<'_>)],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = resources
            .iter()
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding: *binding, resource: resource.clone() })
            .collect();
        self.count().create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }

    /// A bind group layout with `kinds` at bindings 0, 1, ….
    pub fn bind_layout(&self, kinds: &[(Stages, wgpu::BindingType)]) -> wgpu::BindGroupLayout {
        let numbered = kinds.iter().enumerate();
        let entries: Vec<_> = numbered
            .map(|(binding, (visibility, ty))| wgpu::BindGroupLayoutEntry {
                binding: binding as u32,
                visibility: *visibility,
                ty: *ty,
                count: None,
            })
            .collect();
        self.count()
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries })
    }

    /// A pipeline layout of bind groups 0, 1, ….
    pub fn pipeline_layout(&self, groups: &[&wgpu::BindGroupLayout]) -> wgpu::PipelineLayout {
        let groups: Vec<_> = groups.iter().copied().map(Some).collect();
        self.count().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &groups,
            immediate_size: 0,
        })
    }
}

/// Most workgroups along one axis of a dispatch.
const GROUPS_MAX: u32 = 32_768;

/// Spreads `groups` workgroups over two axes: counts along x and y.
pub(crate) fn groups_2d(groups: u32) -> [u32; 2] {
    let x = groups.clamp(1, GROUPS_MAX);
    [x, groups.div_ceil(x).max(1)]
}

/// A view of all layers of a texture, even when there is one.
pub fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// Kind of binding of a storage buffer that is read.
pub fn storage_read() -> wgpu::BindingType {
    buffer_kind(wgpu::BufferBindingType::Storage { read_only: true }, false)
}

/// Kind of binding of a storage buffer that is written.
pub fn storage_write() -> wgpu::BindingType {
    buffer_kind(wgpu::BufferBindingType::Storage { read_only: false }, false)
}

/// Kind of binding of a uniform buffer.
pub fn uniform(dynamic: bool) -> wgpu::BindingType {
    buffer_kind(wgpu::BufferBindingType::Uniform, dynamic)
}

fn buffer_kind(ty: wgpu::BufferBindingType, has_dynamic_offset: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None }
}

/// Kind of binding of a texture.
pub fn texture(
    sample_type: wgpu::TextureSampleType,
    view_dimension: wgpu::TextureViewDimension,
) -> wgpu::BindingType {
    wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

/// An error of the adapter, in words.
pub fn failed(problem: String) -> ClientError {
    ClientError::Adapter { problem }
}
