//! The run time held against closed forms and sums by hand.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};

use super::*;
use crate::content::{
    AreaCode, ClusterTransport, EmitterIrradiance, NearHits, NearSurface, Patch, PatchKey, PatchSet,
    Receivers, TexelEdge, TransportFactors,
};

pub(crate) const BLOCK: u64 = 50;

/// Receivers in one row of block [`BLOCK`], of albedo 1.
fn receivers(count: u16) -> Receivers {
    let each = usize::from(count);
    Receivers {
        blocks: vec![BLOCK],
        block: vec![0; each],
        texel: (0..count).map(|x| [x, 0]).collect(),
        position_m: vec![[0.0; 3]; each],
        normal: vec![[0.0, 1.0, 0.0]; each],
        albedo: vec![[1.0; 3]; each],
        emission: vec![[0.0; 3]; each],
        links: vec![0; each],
        coverage: vec![u16::MAX; each],
        edge: vec![TexelEdge::NONE; each],
    }
}

pub(crate) fn cluster(count: u16) -> ClusterTransport {
    ClusterTransport { receivers: receivers(count), ..ClusterTransport::default() }
}

pub(crate) fn joined<C: Columns>(
    cluster: ClusterTransport,
    columns: impl FnOnce(&SlotTable) -> Result<C, Inconsistent>,
) -> Result<Transport<C>, Inconsistent> {
    Transport::join([(BLOCK, [16, 1])], 6, &[cluster], columns)
}

/// Columns by key with a sky behind them, whose λ the tests write themselves.
#[derive(Debug)]
struct Given {
    keys: Vec<u64>,
    bands: u32,
}

impl Columns for Given {
    fn bands(&self) -> u32 {
        self.bands
    }

    fn lambda_count(&self) -> usize {
        (self.keys.len() + 1) * self.coefficients()
    }

    fn index(&self, key: u64) -> Option<u32> {
        self.keys.iter().position(|known| *known == key).map(|index| index as u32)
    }

    fn sky_index(&self) -> Option<u32> {
        Some(self.keys.len() as u32)
    }

    fn panorama_lambda(&self, _: &Panorama) -> Vec<Vec4> {
        Vec::new()
    }

    fn sky_lambda(&self, _: Sky) -> Vec<Vec4> {
        vec![Vec4::ZERO; self.coefficients()]
    }

    fn surface_lambda(&self, _: &impl Parallel, _: &ReceiverTable, _: Irradiance<'_>) -> Vec<Vec4> {
        vec![Vec4::ZERO; self.keys.len() * self.coefficients()]
    }
}

/// One column with the coefficients of bands 0 and 1.
fn given(_: &SlotTable) -> Result<Given, Inconsistent> {
    Ok(Given { keys: vec![3], bands: 1 })
}

fn patches(set: PatchSet) -> impl FnOnce(&SlotTable) -> Result<PatchTable, Inconsistent> {
    move |slots| PatchTable::new(&set, slots)
}

/// λ where receivers of albedo 1 send these radiances; the sky is black.
pub(crate) fn lambda<C: Columns>(transport: &Transport<C>, radiance: &[Vec3]) -> Vec<Vec4> {
    let dir: Vec<Vec4> = radiance.iter().map(|l| (PI * *l).extend(0.0)).collect();
    let black = vec![Vec4::ZERO; dir.len()];
    let irradiance = Irradiance { dir: &dir, emit: &black, ind: &black };
    transport.lambda(&Serial, irradiance, &transport.columns.sky_lambda(Sky::default()))
}

pub(crate) fn close(a: f32, b: f32) -> bool {
    (a - b).abs() <= 1e-4 * (1.0 + b.abs())
}

#[test]
fn patch_has_the_mean_of_its_receivers_by_area_and_the_sky_its_own() {
    let patch = |key, first_leaf, leaf_count| Patch { key: PatchKey(key), first_leaf, leaf_count };
    let set = PatchSet {
        patches: vec![patch(1, 0, 1), patch(2, 1, 1), patch(3, 0, 2)],
        leaf_starts: vec![0, 1, 4],
        blocks: vec![BLOCK],
        block: vec![0; 4],
        texel: vec![[0, 0], [1, 0], [2, 0], [3, 0]],
        // The last has twice the area of the others.
        area: vec![AreaCode::ONE, AreaCode::ONE, AreaCode::ONE, AreaCode(AreaCode::ONE.0 + 16)],
        sky_parts: 16,
    };
    let transport = joined(cluster(4), patches(set)).unwrap();
    let radiance: Vec<Vec3> = (0..4).map(|x| Vec3::new(7.0, x as f32, 0.0)).collect();
    let found = lambda(&transport, &radiance);
    assert_eq!((found.len(), transport.columns.lambda_count()), (22, 22));
    // The third patch is that of the first two, and part of none.
    let wanted = [[7.0, 0.0], [7.0, 2.25], [7.0, 1.8], [0.0, -1.8], [0.0, 0.45], [7.0, 1.8]];
    for (found, wanted) in found.iter().zip(wanted) {
        assert!(close(found.x, wanted[0]) && close(found.y, wanted[1]), "{found}");
    }
    let grey = Sky { zenith: Vec3::ONE, horizon: Vec3::ONE };
    assert_eq!(transport.columns.sky_lambda(grey), vec![Vec4::new(1.0, 1.0, 1.0, 0.0); 16]);
    assert_eq!(transport.columns.index(PatchKey::of_sky(5).0), Some(6 + 5));
    assert_eq!(
        [1, 2, 3].map(|key| transport.columns.index(PatchKey(key).difference().0)),
        [3, 4, 5].map(Some)
    );
    assert_eq!((transport.columns.index(PatchKey::of_sky(16).0), transport.columns.index(9)), (None, None));
}

/// Two receivers lit by two ranks over a column and the sky, and by emitter 5.
fn factored() -> ClusterTransport {
    ClusterTransport {
        factors: TransportFactors {
            keys: vec![3],
            bands: 0,
            sky: true,
            rank: 2,
            u: vec![1.0, 0.0, 2.0, -1.0],
            vt: vec![1.0, 100.0, 0.5, 4.0],
            ..TransportFactors::default()
        },
        emitters: vec![EmitterIrradiance { emitter: 5, irradiance: vec![[0.0; 3], [1.0, 2.0, 3.0]] }],
        ..cluster(2)
    }
}

#[test]
fn basis_and_irradiance_are_the_factors_times_the_coefficients() {
    // The bake has four coefficients a column, the cluster one: the rest is left out.
    let transport = joined(factored(), given).unwrap();
    let table = &transport.clusters;
    let mut lambda = vec![Vec4::splat(99.0); 8];
    (lambda[0], lambda[4]) = (Vec4::new(2.0, 0.0, 1.0, 0.0), Vec4::new(1.0, 0.0, 0.0, 0.0));
    let b = table.basis(&Serial, &lambda);
    let black_b = [Vec4::ZERO; 6];
    assert_eq!(b, [&[Vec4::new(102.0, 0.0, 1.0, 0.0), Vec4::new(5.0, 0.0, 0.5, 0.0)], &black_b[..]].concat());
    let emit = transport.emitter_irradiance(&[0.0, 0.0, 0.0, 0.0, 0.0, 2.0]);
    let black = vec![Vec4::ZERO; 2];
    let ind = table.reconstruct(&Serial, &b, &black, Some(&emit));
    assert_eq!(ind[0] + emit[0], Vec4::new(102.0, 0.0, 1.0, 0.0));
    assert_eq!(ind[1] + emit[1], Vec4::new(201.0, 4.0, 7.5, 0.0));
    // Ringing takes no more than emitters give.
    let mut negative = [Vec4::ZERO; 8];
    negative[0] = Vec4::splat(-1.0);
    let ind = table.reconstruct(&Serial, &negative, &black, Some(&emit));
    assert_eq!(
        [ind[0] + emit[0], ind[1] + emit[1]].map(Vec4::truncate),
        [Vec3::ZERO, Vec3::new(0.0, 2.0, 4.0)]
    );
    // Rows that have a sign keep it, and add to what they start from.
    let start = [Vec4::splat(0.25), Vec4::ZERO];
    let signed = table.reconstruct(&Serial, &negative, &start, None);
    assert_eq!(signed, [Vec4::splat(-0.75), Vec4::splat(-2.0)]);
}

#[test]
fn near_hits_read_the_light_of_their_texel_or_of_the_receiver_that_meets_them() {
    let surface = vec![
        NearSurface::Texel { block: 0, texel: [1, 0] },
        NearSurface::Own { albedo: [0.5; 3], normal: [1.0, 0.0, 0.0] },
        NearSurface::Texel { block: 0, texel: [9, 0] },
    ];
    let near = NearHits {
        reach_m: 1.0,
        count: vec![3, 0],
        weight: vec![0.25, 0.0],
        blocks: vec![BLOCK],
        surface,
        offset: vec![[0, 0, 0]; 3],
    };
    let transport = joined(ClusterTransport { near, ..cluster(2) }, patches(PatchSet::default())).unwrap();
    let table = &transport.near;
    // The third lies on a texel without receiver: dark.
    assert_eq!(table.hits.iter().map(|hit| hit.light).collect::<Vec<_>>(), [1, OWN_SURFACE]);
    assert!(matches!(
        table.direct_at(0, &transport.receivers),
        DirectAt::Texel { slot: 1, normal: Vec3::Y, .. }
    ));
    assert!(matches!(table.direct_at(1, &transport.receivers), DirectAt::Point { normal: Vec3::X, .. }));
    let ind = [Vec4::splat(4.0), Vec4::splat(2.0)];
    let black = [Vec4::ZERO; 2];
    let irradiance = Irradiance { dir: &black, emit: &black, ind: &ind };
    let gathered =
        table.gather(&Serial, &transport.receivers, &[Vec4::splat(1.0), Vec4::splat(3.0)], irradiance);
    assert!(close(gathered[0].x, 0.25 / PI * ((1.0 + 2.0) + 0.5 * (3.0 + 4.0))), "{}", gathered[0]);
    assert_eq!(gathered[1], Vec4::ZERO);
}

#[test]
fn cluster_that_nothing_reaches_settles_dark_at_once() {
    let transport = joined(cluster(1), patches(PatchSet::default())).unwrap();
    let black = [Vec4::ZERO];
    let incoming = Incoming {
        dir: &black,
        near: &[],
        sky: Sky::default(),
        panorama: None,
        emitter_scale: &[],
        ..Incoming::default()
    };
    let settled = transport.settle(&Serial, &incoming, Limit::default());
    assert_eq!((settled.bounces, settled.converged), (1, true));
    assert_eq!(settled.indirect(0), Vec4::ZERO);
}

/// A receiver that sees itself alone, of albedo 1/2: E_ind = ρ (E_dir + E_ind), hence E_ind = E_dir.
#[test]
fn bounces_sum_to_the_geometric_series_or_say_that_they_were_cut_off() {
    let set = PatchSet {
        patches: vec![Patch { key: PatchKey(1), first_leaf: 0, leaf_count: 1 }],
        leaf_starts: vec![0, 1],
        blocks: vec![BLOCK],
        block: vec![0],
        texel: vec![[0, 0]],
        area: vec![AreaCode::ONE],
        sky_parts: 0,
    };
    let factors = TransportFactors {
        keys: vec![1],
        rank: 1,
        u: vec![PI],
        vt: vec![1.0],
        ..TransportFactors::default()
    };
    let mut content = ClusterTransport { factors, ..cluster(1) };
    content.receivers.albedo = vec![[0.5; 3]];
    let transport = joined(content, patches(set)).unwrap();
    let dir = [Vec4::new(3.0, 1.0, 0.0, 0.0)];
    let incoming = Incoming {
        dir: &dir,
        near: &[],
        sky: Sky::default(),
        panorama: None,
        emitter_scale: &[],
        ..Incoming::default()
    };
    let settled = transport.settle(&Serial, &incoming, Limit { bounces_max: 100, change_max: 1e-5 });
    assert!(settled.converged && (settled.ind[0] - dir[0]).length() < 1e-3, "{}", settled.ind[0]);
    let cut = transport.settle(&Serial, &incoming, Limit { bounces_max: 3, change_max: 1e-5 });
    assert!(!cut.converged && cut.bounces == 3 && close(cut.ind[0].x, 3.0 * 0.875), "{}", cut.ind[0]);
}

#[test]
fn contradictions_between_chunks_are_named() {
    let refused = |change: fn(&mut ClusterTransport)| {
        let mut content = factored();
        change(&mut content);
        joined(content, given).unwrap_err().to_string()
    };
    let cases = [
        ("outside its block", refused(|cluster| cluster.receivers.texel[0] = [16, 0])),
        ("another receiver", refused(|cluster| cluster.receivers.texel[0] = [1, 0])),
        ("names no block", refused(|cluster| cluster.receivers.block[0] = 7)),
        ("which the manifest lacks", refused(|cluster| cluster.receivers.blocks[0] = 51)),
        ("not finite", refused(|cluster| cluster.receivers.position_m[0] = [f32::NAN; 3])),
        ("albedo", refused(|cluster| cluster.receivers.albedo[0] = [2.0; 3])),
        ("lengths", refused(|cluster| cluster.factors.u.truncate(1))),
        ("differ in length", refused(|cluster| cluster.receivers.links.clear())),
        ("differ in length", refused(|cluster| cluster.receivers.coverage.clear())),
        ("differ in length", refused(|cluster| cluster.receivers.edge.clear())),
        ("is in no chunk", refused(|cluster| cluster.factors.keys[0] = 77)),
        ("bands", refused(|cluster| cluster.factors.bands = 2)),
        ("emitter 6", refused(|cluster| cluster.emitters[0].emitter = 6)),
        ("near hits differ", refused(|cluster| cluster.near.count = vec![1])),
    ];
    for (wanted, error) in cases {
        assert!(error.contains(wanted) && error.starts_with("cluster 0"), "'{wanted}' is not in '{error}'");
    }
    let sky = joined(factored(), patches(PatchSet::default())).unwrap_err().to_string();
    assert!(sky.contains("cluster 0"), "{sky}");
    let twice = SlotTable::new([(1, [1, 1]), (1, [1, 1])]).unwrap_err().to_string();
    assert!(twice.contains("key of another"), "{twice}");
    assert!(SlotTable::new([(1, [1 << 20, 1 << 20])]).is_err());
}
