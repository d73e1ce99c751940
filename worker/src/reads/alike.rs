//! The name that tasks over a cell have in common while all that they surely depend on is the same: settings, receivers, emitters.

use lightkiln_proto::ids::Digest;
use serde::Serialize;

use super::marks::Bytes;
use super::stage::Stage;
use super::triangles::Surfaces;
use crate::emitters::EmitterSet;
use crate::geometry::Site;
use crate::lightmap::World;
use crate::patches::PatchTree;

/// Numbers of a scene that no place has, and all tasks depend on.
#[derive(Clone, Debug)]
pub struct Common(Digest);

impl Common {
    /// Of a stage and the settings of a task kind. Gives the stage too.
    pub fn of(
        world: &World,
        tree: &PatchTree,
        emitters: &EmitterSet,
        settings: &impl Serialize,
    ) -> (Self, Stage) {
        let surfaces = Surfaces::new(&world.geometry);
        let stage = Stage::of_world(world, tree, &surfaces);
        let mut bytes = Bytes::default();
        bytes.bytes(serde_json::json!(settings).to_string().as_bytes());
        bytes.floats(&[world.lightmap.texel_m, stage.grid.cell_m]).bytes(&surfaces.emitters(emitters).0);
        let lift_m = world.geometry.tracer.lift_of_all_m();
        bytes.floats(&lift_m);
        (Self(bytes.digest()), stage)
    }
}

impl Common {
    /// The name of tasks that depend on this and on no more than such bytes say.
    pub fn name(&self, bytes: &[u8]) -> Digest {
        let mut all = Bytes::default();
        all.bytes(&self.0.0).bytes(bytes);
        all.digest()
    }
}

/// The name of a cell's tasks: of its receivers, without their colours, and of the points that their rays leave.
pub fn alike(world: &World, common: &Common, bounds_m: &[glam::Vec3; 2], receivers: &[u32]) -> Digest {
    let lightmap = &world.lightmap;
    let mut bytes = Bytes::default();
    bytes.bytes(&common.0.0);
    bounds_m.iter().for_each(|corner| {
        bytes.vector(*corner);
    });
    for &receiver in receivers {
        let own = &lightmap.receivers[receiver as usize];
        let (block, texel) = lightmap.name_of(receiver);
        bytes.number(block).number(u64::from(texel[0]) << 32 | u64::from(texel[1]));
        bytes.number(u64::from(own.links) << 32 | u64::from(own.coverage) << 16 | u64::from(own.edge.0));
        bytes.floats(&[lightmap.texel_m_of(receiver)]);
        add_site(&mut bytes, &own.site());
        // The one whose light it takes, whose random numbers it has.
        let (block, texel) = lightmap.name_of(own.light_of);
        bytes.number(block).number(u64::from(texel[0]) << 32 | u64::from(texel[1]));
        add_site(&mut bytes, &lightmap.receivers[own.light_of as usize].site());
        let points = world.gathering_points_of(receiver);
        bytes.number(points.len() as u64);
        points.iter().for_each(|point| add_site(&mut bytes, point));
    }
    bytes.digest()
}

fn add_site(bytes: &mut Bytes, Site { position_m, normal, face_normal }: &Site) {
    bytes.vector(*position_m).vector(*normal).vector(*face_normal);
}
