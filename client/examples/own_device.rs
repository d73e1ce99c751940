//! A wgpu program of one's own that shares its device with Lightkiln, and reads the irradiance of receivers from its buffers.
//!
//! `cargo run -p lightkiln-client --example own_device -- room.kiln` lights the bake from above, bounces, and lets a shader of its own
//! find the brightest receiver, without a copy to the processor in between.

use std::error::Error;

use lightkiln_client::bake::{LoadedBake, ReceiverBuffers};
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::lights::{Caster, camera_of, parse_light};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::{kinds, wgpu};

/// E = E_dir + E_emit + E_ind of each receiver, W·m⁻²; that of the largest luminance, and its receiver as a number.
const BRIGHTEST: &str = "
@group(0) @binding(0) var<storage, read> direct: array<vec4f>;
@group(0) @binding(1) var<storage, read> emit: array<vec4f>;
@group(0) @binding(2) var<storage, read> indirect: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> brightest: array<vec4f>;

@compute @workgroup_size(1)
fn find() {
    var best = vec4f(0.0);
    for (var slot = 0u; slot < arrayLength(&direct); slot++) {
        let e = direct[slot].rgb + emit[slot].rgb + indirect[slot].rgb;
        if dot(e, vec3f(0.2126, 0.7152, 0.0722)) > dot(best.rgb, vec3f(0.2126, 0.7152, 0.0722)) {
            best = vec4f(e, f32(slot));
        }
    }
    brightest[0] = best;
}
";

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("give a bundle's folder, as 'kiln bake --out' wrote it")?;
    let bake = LoadedBake::load(&Source::bundle(folder)?, &kinds::all())?;

    // The program's own device, as it would have it anyway, with what Lightkiln asks for.
    let (described, device, queue) = own_device()?;
    let gpu = Gpu::share(device.clone(), queue.clone(), &described)?;

    let [low, high] = bake.scene.manifest.bounds_m;
    let middle = [0, 1, 2].map(|axis| low[axis] + 0.5 * (high[axis] - low[axis]));
    let above =
        format!("point pos={},{},{} power=100", middle[0], low[1] + 0.8 * (high[1] - low[1]), middle[2]);
    let lights = [parse_light(&above)?];
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 1024)?;
    let (camera, _) = camera_of(&bake.scene.manifest)?;
    // Pictures are the program's own: Lightkiln's is as small as can be.
    let mut frame = Frame::new(&gpu, &bake, FrameRoom { size: [1, 1], shadows }, camera)?;
    frame.set_lights(&lights)?;
    for _ in 0..8 {
        frame.advance()?;
    }

    let buffers = frame.receiver_buffers().ok_or("the bake's kind has no receivers")?;
    let [red, green, blue, slot] = brightest(&gpu, buffers)?;
    println!("{} receivers on {}", buffers.count, gpu.name);
    println!("the brightest, {slot}, has {red:.3} {green:.3} {blue:.3} W/m2 under \"{above}\"");

    let light = frame.read_receivers()?.ok_or("the bake's kind has no receivers")?;
    let at = slot as usize;
    let on_processor = light.direct[at] + light.emit[at] + light.indirect[at];
    println!("read back: {:.3} {:.3} {:.3} W/m2", on_processor.x, on_processor.y, on_processor.z);
    Ok(())
}

fn own_device() -> Result<(wgpu::AdapterInfo, wgpu::Device, wgpu::Queue), Box<dyn Error>> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("the program's own"),
        required_limits: Gpu::required_limits(),
        required_features: adapter.features() & Gpu::wanted_features(),
        ..Default::default()
    };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))?;
    Ok((adapter.get_info(), device, queue))
}

/// Runs the program's own shader over Lightkiln's buffers.
fn brightest(gpu: &Gpu, buffers: ReceiverBuffers<'_>) -> Result<[f32; 4], Box<dyn Error>> {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("brightest"),
        source: wgpu::ShaderSource::Wgsl(BRIGHTEST.into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("brightest"),
        layout: None,
        module: &module,
        entry_point: Some("find"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let found = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("brightest"),
        size: 16,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let all = [buffers.direct, buffers.emit, buffers.indirect, &found];
    let entries: Vec<wgpu::BindGroupEntry<'_>> = (0..)
        .zip(all)
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &entries,
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(1, 1, 1);
    }
    gpu.queue.submit([encoder.finish()]);
    let found: Vec<f32> = gpu.read(&found, 4)?;
    Ok([found[0], found[1], found[2], found[3]])
}
