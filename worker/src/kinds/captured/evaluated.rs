//! A bake of captured light as evaluation sees it: on surfaces and in free space alike, under the light that it was baked with.

use std::sync::Arc;

use glam::{DVec3, Vec4};
use lightkiln_proto::kinds::captured::{self, Settings, first_tasks, tasks};
use lightkiln_proto::kinds::field::FieldTable;
use lightkiln_proto::manifest::Manifest;

use super::{lighting, role_of};
use crate::evaluate::{Answer, ChunkBytes, Evaluated, EvaluationError, Place, Relit, TestLight};
use crate::factors::Threads;
use crate::geometry::{Geometry, Site};
use crate::kinds::field::{self, SpaceLight};
use crate::kinds::{BakeKinds, FirstTasks, made_anew};
use crate::rays::Hit;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Progress};

/// The bake.
pub struct CapturedBake {
    geometry: Arc<Geometry>,
    field: FieldTable,
    /// Coefficients at probes.
    rows: Vec<Vec4>,
    light: TestLight,
}

/// Reads the scene anew and decodes the bake's chunks.
pub fn evaluated(
    kinds: &BakeKinds,
    manifest: &Manifest,
    scene: Vec<u8>,
    bytes: ChunkBytes,
    progress: &Progress,
) -> Result<CapturedBake, EvaluationError> {
    let settings: Settings = manifest.settings()?;
    let plan = |scene| first_tasks(scene, &settings);
    let first = FirstTasks { kinds, plan, run: &[], up_to: tasks::PLAN.name, or_else: &[] };
    made_anew(first, scene, progress, |context, _| {
        let geometry = Geometry::of(context).map_err(EvaluationError::Prepare)?;
        let lighting = lighting(&geometry).map_err(EvaluationError::Prepare)?;
        let (parts, tetrahedra) = field::parts(manifest, role_of(&settings), bytes)?;
        let field = captured::joined(&manifest.body()?, &parts, tetrahedra.as_ref())?;
        let rows = captured::light(&field, &Threads);
        let words = "the lights of the scene's file, which the bake has captured".to_owned();
        let light = TestLight { name: "captured".into(), words, lighting };
        Ok(CapturedBake { geometry, field, rows, light })
    })
}

impl Evaluated for CapturedBake {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        Answer::Place(Place { site: self.geometry.site_at(hit), number: None })
    }

    fn in_space(self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        Some(field::in_space(self))
    }

    fn own_light(&self) -> Option<TestLight> {
        Some(self.light.clone())
    }

    fn chunk_of(&self, _: &Place) -> Option<usize> {
        None
    }

    fn relit<'a>(
        &'a self,
        _: &Reference,
        _: &Lighting,
        _: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        Ok(Box::new(OnSurfaces(self)))
    }
}

impl SpaceLight for CapturedBake {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn field(&self) -> &FieldTable {
        &self.field
    }

    fn rows(
        &self,
        _: &Reference,
        _: &Lighting,
        _: &Progress,
    ) -> Result<(Vec<Vec4>, (usize, bool)), Cancelled> {
        Ok((self.rows.clone(), (0, true)))
    }

    fn own_light(&self) -> Option<TestLight> {
        Some(self.light.clone())
    }
}

/// Surfaces as probes light them.
struct OnSurfaces<'a>(&'a CapturedBake);

impl Relit for OnSurfaces<'_> {
    fn irradiance(&self, place: &Place) -> Option<DVec3> {
        let CapturedBake { field, rows, .. } = self.0;
        let Site { position_m, normal, face_normal } = place.site;
        Some(field.irradiance(rows, field.raised(position_m, face_normal), normal).as_dvec3())
    }

    fn bounces(&self) -> (usize, bool) {
        (0, true)
    }
}
