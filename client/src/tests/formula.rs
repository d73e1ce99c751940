//! The run time over slots against the same formulas summed by name, straight from the chunks' content.

use std::collections::BTreeMap;
use std::f32::consts::{FRAC_1_PI, PI};

use glam::{Vec3, Vec4};
use lightkiln_proto::content::{ClusterTransport, NearSurface, Patch, PatchKey};
use lightkiln_proto::harmonics::{ShBasis, relight_direction};
use lightkiln_proto::kinds::sh::{RelightHit, sky_coefficients};
use lightkiln_proto::relight::{Columns, Irradiance, Sky, Transport};

use crate::Threads;
use crate::fixture;
use crate::passes::compare::Difference;

const SCALE: f32 = 1.5;

/// λ of every column by its key; the sky's as one column apart.
type Lambda = BTreeMap<u64, Vec<Vec3>>;

/// Light at receivers before a bounce, without pattern.
struct Before {
    dir: Vec<Vec4>,
    emit: Vec<Vec4>,
    ind: Vec<Vec4>,
    /// E_dir by near hit; the hit's height stands for it.
    near: Vec<Vec4>,
}

impl Before {
    fn new<C: Columns>(transport: &Transport<C>) -> Self {
        let count = transport.receivers.len();
        Self {
            dir: (0..count).map(|slot| Vec4::new(slot as f32 % 5.0, 1.0, 0.3, 0.0)).collect(),
            emit: transport.emitter_irradiance(&[SCALE]),
            ind: (0..count).map(|slot| Vec4::new(0.1, slot as f32 % 3.0, 0.2, 0.0)).collect(),
            near: transport.near.hits.iter().map(|hit| Vec4::new(hit.position_m[1], 0.5, 0.1, 0.0)).collect(),
        }
    }

    /// E_emit + E_ind after one bounce of the run time.
    fn bounced<C: Columns>(&self, transport: &Transport<C>, sky: Sky) -> Vec<Vec4> {
        let irradiance = Irradiance { dir: &self.dir, emit: &self.emit, ind: &self.ind };
        let lambda = transport.lambda(&Threads, irradiance, &transport.columns.sky_lambda(sky));
        let b = transport.clusters.basis(&Threads, &lambda);
        let near = transport.near.gather(&Threads, &transport.receivers, &self.near, irradiance);
        let ind = transport.clusters.reconstruct(&Threads, &b, &near, Some(&self.emit));
        ind.iter().zip(&self.emit).map(|(ind, emit)| *ind + *emit).collect()
    }

    /// Radiance of a receiver by name; 0 where no cluster has it.
    fn radiance<C>(&self, transport: &Transport<C>, block: u64, texel: [u16; 2]) -> Vec3 {
        let Some(slot) = transport.slots.slot_of(block, texel) else { return Vec3::ZERO };
        let slot = slot as usize;
        let e = self.dir[slot] + self.emit[slot] + self.ind[slot];
        (transport.receivers.albedo[slot] * FRAC_1_PI * e).truncate()
    }
}

/// `E_r = max(0, N_r + Σ_i U_ri Σ_c (ΣVᵀ)_ic λ_c + Σ_e s E_re)` of a cluster.
fn irradiance(cluster: &ClusterTransport, lambda: &Lambda, sky: &[Vec3], near: &[Vec3]) -> Vec<Vec4> {
    let dark = vec![Vec3::ZERO; cluster.factors.coefficients()];
    let of_keys = cluster.factors.keys.iter().flat_map(|key| lambda.get(key).unwrap_or(&dark));
    let columns: Vec<Vec3> = of_keys.chain(if cluster.factors.sky { sky } else { &[] }).copied().collect();
    let (rank, count) = (cluster.factors.rank as usize, columns.len());
    let row =
        |i: usize| columns.iter().zip(&cluster.factors.vt[i * count..]).map(|(l, v)| *l * *v).sum::<Vec3>();
    let b: Vec<Vec3> = (0..rank).map(row).collect();
    let at = |r: usize| {
        let factors = b.iter().zip(&cluster.factors.u[r * rank..]).map(|(b, u)| *b * *u).sum::<Vec3>();
        let emitted =
            cluster.emitters.iter().map(|part| SCALE * Vec3::from(part.irradiance[r])).sum::<Vec3>();
        (near[r] + factors + emitted).max(Vec3::ZERO).extend(0.0)
    };
    (0..cluster.receivers.len()).map(at).collect()
}

fn held(what: &str, got: &[Vec4], wanted: &[Vec4]) {
    let difference = Difference::of(got, wanted, 1e-5);
    println!("{what}: {difference}");
    assert!(difference.agrees(0.0), "{what}: {difference}");
}

#[test]
fn bounce_over_probes_is_the_formula_summed_by_name() {
    let contents = fixture::sh_contents();
    let (scene, light) = fixture::sh_light(&contents);
    let (transport, sky) = (&light.transport, Sky::of(&scene.manifest.lights));
    let before = Before::new(transport);
    let batch = &contents.probes[0];
    let sh = ShBasis::new(transport.columns.bands as usize);
    let mut y = vec![0.0; sh.coefficients()];
    let mut lambda = Lambda::new();
    for (probe, hits) in batch.probes.iter().zip(batch.hits.chunks(batch.relight_rays as usize)) {
        let mut sums = vec![Vec3::ZERO; sh.coefficients()];
        for (ray, hit) in (0..).zip(hits) {
            let RelightHit::Receiver { block, texel } = *hit else { continue };
            let radiance = before.radiance(transport, batch.blocks[usize::from(block)], texel);
            sh.evaluate(relight_direction(ray, batch.relight_rays), &mut y);
            let weight = 4.0 * PI / batch.relight_rays as f32;
            sums.iter_mut().zip(&y).for_each(|(sum, y)| *sum += weight * *y * radiance);
        }
        lambda.insert(probe.key, sums);
    }
    let of_sky: Vec<Vec3> =
        sky_coefficients(sky, transport.columns.bands).iter().map(|l| l.truncate()).collect();
    let wanted = contents.clusters.iter().flat_map(|cluster| {
        irradiance(cluster, &lambda, &of_sky, &vec![Vec3::ZERO; cluster.receivers.len()])
    });
    held("probes", &before.bounced(transport, sky), &wanted.collect::<Vec<_>>());
}

#[test]
fn bounce_over_patches_is_the_formula_summed_by_name() {
    let contents = fixture::narrow_contents();
    let (scene, light) = fixture::prt_light(&contents);
    let (transport, sky) = (&light.transport, Sky::of(&scene.manifest.lights));
    let before = Before::new(transport);
    let set = &contents.patches[0];
    let mut lambda = Lambda::new();
    for patch in &set.patches {
        let [first, end] = [patch.first_leaf, patch.first_leaf + patch.leaf_count]
            .map(|leaf| set.leaf_starts[leaf as usize] as usize);
        let (mut sum, mut area) = (Vec3::ZERO, 0.0);
        for at in first..end {
            let texels = set.area[at].texels();
            let block = set.blocks[set.block[at] as usize];
            sum += texels * before.radiance(transport, block, set.texel[at]);
            area += texels;
        }
        lambda.insert(patch.key.0, vec![sum / area]);
    }
    let leaves = set.patches.iter().filter(|patch| patch.leaf_count == 1);
    for leaf in leaves {
        let of_wall = |wall: &&Patch| {
            wall.leaf_count > 1
                && (wall.first_leaf..wall.first_leaf + wall.leaf_count).contains(&leaf.first_leaf)
        };
        let wall = set.patches.iter().find(of_wall).unwrap();
        let difference = lambda[&leaf.key.0][0] - lambda[&wall.key.0][0];
        lambda.insert(leaf.key.difference().0, vec![difference]);
    }
    for part in 0..set.sky_parts {
        let radiance = sky.radiance(relight_direction(part, set.sky_parts));
        lambda.insert(PatchKey::of_sky(part).0, vec![radiance]);
    }
    let mut first = 0;
    let mut wanted = Vec::new();
    for cluster in &contents.clusters {
        let near = near_of(cluster, first, transport, &before);
        wanted.extend(irradiance(cluster, &lambda, &[], &near));
        first += cluster.receivers.len();
    }
    held("patches", &before.bounced(transport, sky), &wanted);
}

/// `N_r = w_r Σ_y ρ/π (E_dir(y) + E_emit + E_ind)` of a cluster whose receivers begin at slot `first`.
fn near_of<C>(
    cluster: &ClusterTransport,
    first: usize,
    transport: &Transport<C>,
    before: &Before,
) -> Vec<Vec3> {
    let near = &cluster.near;
    let mut sums = vec![Vec3::ZERO; cluster.receivers.len()];
    for (hit, own) in near.receivers().enumerate() {
        let (light, albedo, normal) = match near.surface[hit] {
            NearSurface::Own { albedo, normal } => (first + own, Vec3::from(albedo), normal),
            NearSurface::Texel { block, texel } => {
                let block = near.blocks[usize::from(block)];
                let Some(on) = transport.slots.slot_of(block, texel) else { continue };
                let on = on as usize;
                let receivers = &transport.receivers;
                (on, receivers.albedo[on].truncate(), receivers.normal[on].truncate().into())
            }
        };
        let y = near.position_m(hit, cluster.receivers.position_m[own], normal)[1];
        let e = Vec3::new(y, 0.5, 0.1) + (before.emit[light] + before.ind[light]).truncate();
        sums[own] += near.weight[own] * albedo * FRAC_1_PI * e;
    }
    sums
}
