//! The directory: a bake's clusters in pages of their own, so that a client knows a huge bake after a few of them.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::{CLUSTERS, ChunkRef, ClusterRow, Manifest, ManifestError};
use crate::chunk::limits::DIRECTORY_CLUSTERS_MAX;
use crate::chunk::{decode_directory, encode_directory};
use crate::ids::Digest;

/// Role of the pages of the directory.
pub const DIRECTORY: &str = "directory";
/// Clusters in a page. More → fewer requests, and more bytes that a client must have before the first cluster.
const PAGE_CLUSTERS: usize = 256;
/// Longest page that is read; those of most clusters take 0.7 MB before compression.
pub const PAGE_BYTES_MAX: u64 = 1 << 20;
/// Most clusters of a bake.
pub const CLUSTERS_MAX: u64 = 1 << 20;

/// A page, as one must know it to choose whether to fetch it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectoryPage {
    /// Bounds of its clusters, in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Clusters in it.
    pub clusters: u32,
}

/// A manifest as it is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// The manifest's JSON.
    pub json: Vec<u8>,
    /// The chunks that are pages of its directory, in order.
    pub pages: Vec<Vec<u8>>,
}

impl DirectoryPage {
    fn of(rows: &[ClusterRow]) -> Self {
        let corner = |side: usize, start: f32, outer: fn(f32, f32) -> f32| {
            std::array::from_fn(|axis| rows.iter().map(|row| row.bounds_m[side][axis]).fold(start, outer))
        };
        let bounds_m = [corner(0, f32::INFINITY, f32::min), corner(1, f32::NEG_INFINITY, f32::max)];
        Self { bounds_m, clusters: rows.len() as u32 }
    }
}

impl Manifest {
    /// The manifest with its directory in pages, as stored. Errs if there are not as many clusters as chunks of them, or one is out
    /// of its limits.
    pub fn stored(mut self) -> Result<Stored, ManifestError> {
        let chunks = self.chunks.remove(CLUSTERS).unwrap_or_default();
        if chunks.len() != self.clusters.len() {
            let problem =
                format!("it has {} clusters and {} chunks of them", self.clusters.len(), chunks.len());
            return Err(ManifestError::Contradiction { problem });
        }
        let rows = self.clusters.chunks(PAGE_CLUSTERS);
        self.directory = rows.clone().map(DirectoryPage::of).collect();
        let pages: Vec<Vec<u8>> = rows
            .zip(chunks.chunks(PAGE_CLUSTERS))
            .map(|(rows, chunks)| encode_directory(rows, chunks))
            .collect::<Result<_, _>>()?;
        let page = |page: &Vec<u8>| ChunkRef { digest: Digest::of(page), bytes: page.len() as u64 };
        self.chunks.remove(DIRECTORY);
        if !pages.is_empty() {
            self.chunks.insert(DIRECTORY.to_owned(), pages.iter().map(page).collect());
        }
        // By way of a JSON value: its maps are sorted, which makes the manifest canonical.
        let json = serde_json::to_value(&self)?.to_string().into_bytes();
        Ok(Stored { json, pages })
    }

    /// Errs unless each page has a chunk of its own, and they hold no more than can be read: a page may be some hundred bytes for
    /// a megabyte of clusters.
    pub(super) fn check_directory(&self) -> Result<(), ManifestError> {
        let (pages, chunks) = (&self.directory, self.chunks(DIRECTORY));
        let is_page = |page: &DirectoryPage| (1..=DIRECTORY_CLUSTERS_MAX).contains(&(page.clusters as usize));
        let different: BTreeSet<Digest> = chunks.iter().map(|chunk| chunk.digest).collect();
        let clusters: u64 = pages.iter().map(|page| u64::from(page.clusters)).sum();
        let problem = if self.chunks.contains_key(CLUSTERS) {
            format!("it names '{CLUSTERS}' beside its directory")
        } else if pages.len() != chunks.len() {
            format!("its directory has {} pages and {} chunks of them", pages.len(), chunks.len())
        } else if different.len() != chunks.len() {
            "its directory has a page twice".to_owned()
        } else if !pages.iter().all(is_page) || clusters > CLUSTERS_MAX {
            format!(
                "its directory has {clusters} clusters; a page has 1 to {DIRECTORY_CLUSTERS_MAX}, all {CLUSTERS_MAX}"
            )
        } else if chunks.iter().any(|chunk| chunk.bytes > PAGE_BYTES_MAX) {
            format!("its directory has a page of more than {PAGE_BYTES_MAX} bytes")
        } else {
            return Ok(());
        };
        Err(ManifestError::Contradiction { problem: format!("{problem}: it is damaged") })
    }

    /// The manifest with the clusters of its directory, of which these are all pages. Errs if one is not what the manifest says.
    pub fn with_directory(mut self, pages: &[Vec<u8>]) -> Result<Self, ManifestError> {
        let wrong = |problem: String| ManifestError::Contradiction { problem };
        if pages.len() != self.directory.len() {
            let wanted = self.directory.len();
            return Err(wrong(format!("its directory has {wanted} pages, and {} were read", pages.len())));
        }
        let (mut rows, mut refs) = (Vec::new(), Vec::new());
        for (index, (page, bytes)) in self.directory.iter().zip(pages).enumerate() {
            let (found, chunks) =
                decode_directory(bytes).map_err(|source| ManifestError::Page { index, source })?;
            let listed = DirectoryPage::of(&found);
            if listed != *page {
                return Err(wrong(format!(
                    "page {index} of its directory has {} clusters, wanted {}, or other bounds than it says",
                    listed.clusters, page.clusters
                )));
            }
            rows.extend(found);
            refs.extend(chunks);
        }
        if !rows.is_empty() {
            self.chunks.insert(CLUSTERS.to_owned(), refs);
        }
        self.clusters = rows;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::manifest::{FORMAT, Layer, VERSION};

    /// A manifest of that many clusters in a row, 1 m each.
    fn manifest(clusters: usize) -> Manifest {
        let json = json!({
            "format": FORMAT, "version": VERSION, "kind": "any", "scene": Digest::of(b""), "settings": {},
            "bounds_m": [[0, 0, 0], [1, 1, 1]], "triangles": 0, "lightmap": null, "materials": [], "emitters": [],
            "lights": [], "cameras": [], "framing": {}, "chunks": {}, "body": {},
        });
        let mut manifest = Manifest::from_json(json.to_string().as_bytes()).unwrap();
        let chunk = |index: usize| ChunkRef { digest: Digest::of(&index.to_le_bytes()), bytes: 7 };
        let row = |index: usize| ClusterRow {
            bounds_m: [[index as f32, 0.0, 0.0], [index as f32 + 1.0, 1.0, 1.0]],
            receivers: 5,
            keys: 4,
            rank: 3,
            truncation_error: 0.1,
            quantisation_error: 0.2,
            uncovered_fraction: 0.3,
            layers: vec![Layer { bytes: 7, level: 0, bands: 0, rank: 3 }],
            checks: Vec::new(),
        };
        manifest.chunks.insert(CLUSTERS.to_owned(), (0..clusters).map(chunk).collect());
        manifest.clusters = (0..clusters).map(row).collect();
        manifest
    }

    #[test]
    fn clusters_come_back_from_their_pages() {
        for clusters in [0, 1, PAGE_CLUSTERS, 2 * PAGE_CLUSTERS + 9] {
            let made = manifest(clusters);
            let stored = made.clone().stored().unwrap();
            assert_eq!(stored.pages.len(), clusters.div_ceil(PAGE_CLUSTERS));
            assert!(stored.json.len() < 1000 + 250 * stored.pages.len(), "{} bytes", stored.json.len());
            let head = Manifest::from_json(&stored.json).unwrap();
            let last = head.directory.last().map_or(0, |page| page.bounds_m[1][0] as usize);
            assert_eq!(last, clusters);
            let read = head.with_directory(&stored.pages).unwrap();
            assert_eq!((&read.clusters, read.chunks(CLUSTERS)), (&made.clusters, made.chunks(CLUSTERS)));
            assert_eq!(read.stored().unwrap(), stored, "what was read is stored as it was");
        }
    }

    #[test]
    fn pages_that_are_not_those_of_the_manifest_are_refused() {
        let stored = manifest(PAGE_CLUSTERS + 9).stored().unwrap();
        let refused = |change: fn(&mut Manifest), pages: &[Vec<u8>]| {
            let mut head = Manifest::from_json(&stored.json).unwrap();
            change(&mut head);
            head.with_directory(pages).unwrap_err().to_string()
        };
        let [first, last] = [0, 1].map(|page: usize| stored.pages[page].clone());
        assert!(refused(|_| (), std::slice::from_ref(&first)).contains("1 were read"));
        assert!(refused(|_| (), &[first.clone(), first.clone()]).contains("page 1"));
        assert!(refused(|_| (), &[first.clone(), last[1..].to_vec()]).contains("page 1"));
        let moved = |head: &mut Manifest| head.directory[0].bounds_m[1][2] = 2.0;
        assert!(refused(moved, &[first, last]).contains("page 0"));
        let head = |change: fn(&mut Manifest)| {
            let mut head = Manifest::from_json(&stored.json).unwrap();
            change(&mut head);
            Manifest::from_json(&serde_json::to_vec(&head).unwrap()).unwrap_err().to_string()
        };
        let both = |head: &mut Manifest| {
            head.chunks.insert(CLUSTERS.to_owned(), Vec::new());
        };
        assert!(head(both).contains("beside"));
        assert!(head(|head| head.directory.truncate(1)).contains("1 pages and 2 chunks"));
        assert!(head(|head| head.directory[0].clusters = 0).contains("a page has 1 to"));
        assert!(head(|head| head.directory[0].clusters = 1 << 30).contains("a page has 1 to"));
        let twice = |head: &mut Manifest| {
            let chunks = head.chunks.get_mut(DIRECTORY).unwrap();
            chunks[1] = chunks[0].clone();
        };
        assert!(head(twice).contains("a page twice"));
        assert!(
            head(|head| head.chunks.get_mut(DIRECTORY).unwrap()[0].bytes = 2 << 20).contains("more than")
        );
        let mut fewer = manifest(3);
        fewer.clusters.pop();
        assert!(fewer.stored().unwrap_err().to_string().contains("2 clusters and 3 chunks"));
    }
}
