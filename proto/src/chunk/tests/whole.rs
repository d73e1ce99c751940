//! Rules that every decoded chunk keeps, whatever the bytes were. Tests of this crate and fuzz targets share it; whoever takes it in
//! has the types in scope.

use super::{
    BRICKS_MAX, Brick, ChunkRef, ClusterRow, ClusterTransport, FieldPart, Geometry, MAP_POINTS, MOVES_MAX,
    NearHits, NearSurface, PROBE_ROWS, PatchKey, PatchSet, ProbeBatch, Receivers, RelightHit, TetrahedronSet,
    TransferLevel, VOXEL_LEVELS_MAX, VoxelPart,
};

/// Every array has its length, every index its target, every number is finite.
pub fn assert_whole(cluster: &ClusterTransport) {
    let Receivers { blocks, block, texel, position_m, normal, albedo, emission, links, coverage, edge } =
        &cluster.receivers;
    let count = texel.len();
    assert_eq!([block.len(), position_m.len(), normal.len()], [count; 3]);
    assert_eq!([albedo.len(), emission.len(), links.len(), coverage.len(), edge.len()], [count; 5]);
    assert!(block.iter().all(|&block| usize::from(block) < blocks.len()));
    assert_eq!(cluster.factors.u.len(), count * cluster.factors.rank as usize);
    assert_eq!(cluster.factors.vt.len(), cluster.factors.columns() * cluster.factors.rank as usize);
    let steps = &cluster.factors.steps;
    assert_eq!([steps.u.len(), steps.vt.len()], [cluster.factors.rank as usize; 2]);
    assert!(steps.scale.is_empty() || steps.scale.len() == cluster.factors.keys.len());
    assert!(cluster.emitters.iter().all(|emitter| emitter.irradiance.len() == count));
    let emitted = cluster.emitters.iter().flat_map(|emitter| emitter.irradiance.as_flattened());
    let vectors = [position_m, normal, albedo, emission].into_iter().flat_map(|v| v.as_flattened());
    assert!(
        cluster
            .factors
            .u
            .iter()
            .chain(&cluster.factors.vt)
            .chain(emitted)
            .chain(vectors)
            .all(|x| x.is_finite())
    );
    assert!(albedo.as_flattened().iter().all(|albedo| (0.0..1.0).contains(albedo)));
    assert!((0..3).all(|axis| cluster.bounds_m[0][axis] <= cluster.bounds_m[1][axis]), "bounds inside out");
    assert_near(&cluster.near, count);
}

/// Every near hit has a receiver, a block and a place within the reach.
fn assert_near(near: &NearHits, receivers: usize) {
    let hits = near.len();
    assert_eq!(near.offset.len(), hits);
    assert!([0, receivers].contains(&near.count.len()) && near.count.len() == near.weight.len());
    assert_eq!(near.ranges().last().map_or(0, |last| last.end), hits);
    let is_there = |surface: &NearSurface| match surface {
        NearSurface::Texel { block, .. } => usize::from(*block) < near.blocks.len(),
        NearSurface::Own { albedo, normal } => {
            albedo.iter().all(|albedo| (0.0..1.0).contains(albedo)) && normal.iter().all(|x| x.is_finite())
        }
    };
    assert!(near.surface.iter().all(is_there));
    assert!(near.offset.as_flattened().iter().all(|code| code.abs() <= NearHits::STEPS));
    assert!(near.weight.iter().all(|weight| (0.0..3.15).contains(weight)) && near.reach_m.is_finite());
}

/// Every probe has its hits, and every hit its block.
pub fn assert_batch(batch: &ProbeBatch) {
    assert_eq!(batch.hits.len(), batch.probes.len() * batch.relight_rays as usize);
    let known = |hit: &RelightHit| match *hit {
        RelightHit::Receiver { block, .. } => usize::from(block) < batch.blocks.len(),
        _ => true,
    };
    assert!(batch.hits.iter().all(known));
}

/// Every probe has a depth map, rows of its own, and a place of its own on the lattice.
pub fn assert_field(part: &FieldPart) {
    let (probes, rank) = (part.probes.len(), part.factors.rank as usize);
    assert!(part.probes.windows(2).all(|pair| pair[0].key < pair[1].key));
    assert!(part.probes.iter().all(|probe| probe.position_m(part.spacing_m).is_finite()));
    assert!(part.probes.iter().all(|probe| probe.moved.iter().all(|step| step.abs() <= MOVES_MAX)));
    assert_eq!(part.depths.len(), probes * MAP_POINTS);
    assert_eq!(part.factors.u.len(), probes * PROBE_ROWS * rank);
    assert_eq!(part.factors.vt.len(), part.factors.keys.len() * rank);
    assert!(part.emitters.windows(2).all(|pair| pair[0].emitter < pair[1].emitter));
    assert!(part.emitters.iter().all(|entry| entry.irradiance.len() == probes * PROBE_ROWS));
}

/// Tetrahedra are in order, each of four vertices that are there.
pub fn assert_tetrahedra(set: &TetrahedronSet) {
    assert!(set.vertices.windows(2).all(|pair| pair[0] < pair[1]));
    assert!(set.vertices.iter().all(|of| of.windows(2).all(|pair| pair[0] < pair[1])));
    assert!(set.vertices.iter().all(|of| of[3] < set.probes + 8));
    let [low, high] = set.box_m;
    assert!((0..3).all(|axis| high[axis] > low[axis] || set.vertices.is_empty() && high[axis] == low[axis]));
}

/// All parts have codes, and what they name is there.
pub fn assert_transfer(level: &TransferLevel) {
    assert!((4..=64).contains(&level.nodes) && level.level < 4 && level.parts.len() <= 64);
    assert_eq!(level.codes.len(), level.parts.len() * level.node_count());
    assert!(!level.codes.as_flattened().contains(&i8::MIN));
    for part in &level.parts {
        assert!(part.patches.windows(2).all(|pair| pair[0].key < pair[1].key));
        assert!(part.patches.iter().all(|patch| patch.key.sky().is_none() && !patch.key.is_difference()));
        assert!(part.patches.iter().all(|patch| (0.0..=1.0).contains(&patch.share)));
        assert!(part.glows.iter().flat_map(|glow| glow.share).all(|share| share >= 0.0 && share.is_finite()));
        let numbers = [&part.middle_m[..], &part.plane, &part.steps];
        assert!(numbers.concat().iter().all(|number| number.is_finite()));
    }
}

/// Bricks and voxels are in order and hold something, and what elements name is there.
pub fn assert_voxels(part: &VoxelPart) {
    let order = |brick: &Brick| (VOXEL_LEVELS_MAX - brick.key.level, brick.key);
    assert!(part.bricks.windows(2).all(|pair| order(&pair[0]) < order(&pair[1])));
    for brick in &part.bricks {
        assert!(brick.key.level < VOXEL_LEVELS_MAX);
        assert!(brick.key.cell().abs().max_element() <= BRICKS_MAX);
        assert!(!brick.voxels.is_empty() && brick.voxels.iter().all(|voxel| voxel.elements > 0));
        assert!(brick.voxels.windows(2).all(|pair| pair[0].place < pair[1].place));
        assert!(brick.voxels.last().is_none_or(|voxel| voxel.place < 512));
        let elements: usize = brick.voxels.iter().map(|voxel| usize::from(voxel.elements)).sum();
        assert_eq!(brick.elements.len(), elements);
    }
    let elements = || part.bricks.iter().flat_map(|brick| &brick.elements);
    assert!(elements().all(|element| element.bits != 0));
    assert!(elements().all(|element| usize::from(element.glow) <= part.glows.len()));
    let is_patch = |key: PatchKey| key.level() <= 14 && key.direction() <= 5;
    assert!(elements().filter_map(|element| element.patch).all(is_patch));
    assert!(part.glows.iter().flat_map(|glow| glow.share).all(|share| share >= 0.0 && share.is_finite()));
}

/// Patches are in order, each over leaves that are there, each leaf over texels that are.
pub fn assert_patches(set: &PatchSet) {
    let leaves = set.leaf_starts.len() - 1;
    assert!(set.patches.iter().all(|p| p.leaf_count > 0 && (p.first_leaf + p.leaf_count) as usize <= leaves));
    assert!(set.patches.windows(2).all(|pair| pair[0].key < pair[1].key));
    assert!(set.leaf_starts.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!([set.block.len(), set.leaf_starts[leaves] as usize], [set.texel.len(); 2]);
    assert!(set.block.iter().all(|&block| (block as usize) < set.blocks.len()));
}

/// Vertices have all that they need, and triangles their vertices.
pub fn assert_geometry(geometry: &Geometry) {
    for draw in &geometry.draws {
        let count = draw.position_m.len();
        let in_lightmap = if draw.front.is_some() { count } else { 0 };
        assert_eq!([draw.normal.len(), draw.lightmap_texel.len()], [count, in_lightmap]);
        assert!(draw.front.is_some() || draw.back.is_none());
        assert!([0, count].contains(&draw.uv.len()) && [0, count].contains(&draw.colour.len()));
        assert!(draw.triangles.as_flattened().iter().all(|&index| (index as usize) < count));
    }
}

/// Every cluster has a chunk, which its last layer is, and a check of each other layer.
pub fn assert_directory(rows: &[ClusterRow], chunks: &[ChunkRef]) {
    assert_eq!(rows.len(), chunks.len());
    for (row, chunk) in rows.iter().zip(chunks) {
        assert_eq!(row.layers.last().map(|layer| layer.bytes), Some(chunk.bytes));
        assert_eq!(row.checks.len() + 1, row.layers.len());
        assert!(row.layers.windows(2).all(|pair| pair[0].bytes < pair[1].bytes));
        let errors = [row.truncation_error, row.quantisation_error, row.uncovered_fraction];
        assert!(row.bounds_m.as_flattened().iter().chain(&errors).all(|number| number.is_finite()));
    }
}
