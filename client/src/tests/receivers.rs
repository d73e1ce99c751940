//! Light at receivers for other programs: of adapter and processor alike, and on a device that is another program's.

use super::view_of;
use crate::bake::ReceiverLight;
use crate::fixture;
use crate::frame::{Frame, FrameRoom};
use crate::lights::Caster;
use crate::passes::compare::Difference;
use crate::passes::direct;
use crate::passes::gpu::Gpu;
use crate::passes::shadow::ShadowRoom;
use crate::preview::{Backend, light_receivers};

/// Largest difference of indirect light, relative to the largest value: bounces end within 1e-3 of where they would.
const TOLERANCE: f32 = 4e-3;

fn held(got: &ReceiverLight, wanted: &ReceiverLight) {
    let arrays = [
        (&got.direct, &wanted.direct, direct::TOLERANCE, 4.0 * direct::OUTLIERS),
        (&got.emit, &wanted.emit, 1e-6, 0.0),
        (&got.indirect, &wanted.indirect, TOLERANCE, 0.0),
        (&got.probes, &wanted.probes, TOLERANCE, 0.0),
    ];
    assert_eq!(got.probes.len(), wanted.probes.len());
    // Bakes without light in free space have no probes.
    for (got, wanted, tolerance, outliers) in arrays.into_iter().filter(|(_, wanted, ..)| !wanted.is_empty())
    {
        let difference = Difference::of(got, wanted, tolerance);
        assert!(difference.agrees(outliers), "{difference:?}");
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_lights_receivers_as_the_processor_does() {
    let fields = [true, false].map(fixture::field_bake);
    for bake in [fixture::prt_bake(&fixture::prt_contents()), fixture::sh_bake()].into_iter().chain(fields) {
        let lit = |lights, backend| light_receivers(&bake, lights, None, vec![1.5], backend).unwrap();
        let [got, wanted] = [Backend::Gpu, Backend::Cpu].map(|backend| lit(fixture::lights(), backend));
        assert!(got.settled.converged && wanted.settled.converged && got.lit_by != wanted.lit_by);
        held(&got.settled.light, &wanted.settled.light);
        assert_eq!(wanted.settled.light.probes.is_empty(), bake.light.free_space().is_none());
        // Other light is told from it.
        let other = lit(fixture::lights()[1..].to_vec(), Backend::Cpu).settled.light;
        let difference = Difference::of(&got.settled.light.indirect, &other.indirect, TOLERANCE);
        assert!(!difference.agrees(0.0), "{difference:?}");
    }
}

fn device(limits: wgpu::Limits) -> (wgpu::AdapterInfo, wgpu::Device, wgpu::Queue) {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    let required_features = adapter.features() & Gpu::wanted_features();
    let descriptor =
        wgpu::DeviceDescriptor { required_limits: limits, required_features, ..Default::default() };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
    (adapter.get_info(), device, queue)
}

#[test]
#[ignore = "needs a graphics adapter"]
fn device_of_another_program_lights_alike_where_its_limits_allow_it_on_any_adapter() {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let (described, shared, queue) = device(Gpu::required_limits());
    let gpu = Gpu::share(shared, queue, &described).unwrap();
    let lights = fixture::lights();
    let shadows = ShadowRoom::for_lights(&Caster::of(&lights), 2048).unwrap();
    let camera = view_of(&bake).camera;
    let mut frame = Frame::new(&gpu, &bake, FrameRoom { size: [1, 1], shadows }, camera).unwrap();
    frame.set_lights(&lights).unwrap();
    frame.settle(Default::default()).unwrap();
    let wanted = light_receivers(&bake, lights, None, vec![], Backend::Cpu).unwrap().settled.light;
    held(&frame.read_receivers().unwrap().unwrap(), &wanted);
    let (described, poor, queue) = device(wgpu::Limits::downlevel_webgl2_defaults());
    let refused = Gpu::share(poor, queue, &described).unwrap_err().to_string();
    assert!(refused.contains("max_storage_buffers_per_shader_stage 0, wanted 8"), "{refused}");
}
