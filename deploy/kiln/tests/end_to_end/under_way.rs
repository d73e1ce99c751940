//! A bake under way as a source of light: its outline, and the clusters of its cells as they land.

use lightkiln_client::fetch::{ApiClient, Source};
use lightkiln_proto::api::{BakeResult, ResultPage};
use lightkiln_proto::chunk::decode_directory;
use lightkiln_proto::jobs::Artefact;
use lightkiln_proto::kinds::prt::{Body, tasks};
use lightkiln_proto::kinds::{Kinds, OUTLINE_OUTPUT, PAGE_OUTPUT, UnderWay};
use lightkiln_proto::manifest::{CLUSTERS, ChunkRef, ClusterRow, DIRECTORY, Manifest, OVERVIEW};

use super::farm::arguments;
use super::processes::{Server, kiln, run};

/// Longest chunk of a small bake.
const LIMIT_BYTES: u64 = 1 << 24;

/// All results of a bake, of one kind of task if that is named, until it has ended.
fn followed(server: &Server, bake: &str, kind: &str) -> Vec<BakeResult> {
    let (mut all, mut after): (Vec<BakeResult>, u64) = (Vec::new(), 0);
    loop {
        let url = format!("{}/v1/bakes/{bake}/results?after={after}&limit=7&wait_secs=30{kind}", server.url);
        let body = ureq::get(&url).call().unwrap().body_mut().read_to_vec().unwrap();
        let page: ResultPage = serde_json::from_slice(&body).unwrap();
        if page.results.is_empty() && page.bake.state.is_final() {
            assert!(page.bake.failure.is_none(), "{:?}", page.bake);
            return all;
        }
        after = page.results.last().map_or(after, |result| result.place);
        all.extend(page.results);
    }
}

fn output<'a>(result: &'a BakeResult, name: &str) -> &'a Artefact {
    let found = result.outputs.iter().find(|output| output.name == name);
    found.unwrap_or_else(|| panic!("no '{name}': {result:?}"))
}

/// Rows with their chunks in an order that does not hang on when they came.
fn sorted(mut rows: Vec<(ClusterRow, ChunkRef)>) -> Vec<(ClusterRow, ChunkRef)> {
    rows.sort_by_key(|(_, chunk)| chunk.digest);
    rows
}

#[test]
fn light_of_a_bake_lands_cell_by_cell_behind_an_outline_and_is_that_of_its_manifest() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", &server.url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let _worker = server.worker(folder.path(), "only", 1);
    let UnderWay { outline, clusters } = Kinds::new().default_kind().under_way().unwrap();
    let pages = followed(&server, &bake, &format!("&kind={clusters}"));

    // One worker that does one task at a time colours each cell before it casts a ray for the next.
    let all = followed(&server, &bake, "");
    let order: Vec<(&str, &str)> = all
        .iter()
        .filter(|result| [tasks::TRANSPORT.name, clusters].contains(&result.kind.as_str()))
        .map(|result| (result.kind.as_str(), result.label.as_str()))
        .collect();
    assert!(order.len() > 8, "{order:?}");
    for pair in order.chunks(2) {
        assert_eq!([pair[0].0, pair[1].0, pair[1].1], [tasks::TRANSPORT.name, clusters, pair[0].1]);
    }
    assert!(all.windows(2).all(|pair| pair[0].place < pair[1].place));
    let of_clusters = all.iter().filter(|result| result.kind == clusters);
    assert_eq!(of_clusters.cloned().collect::<Vec<_>>(), pages);

    // The outline is the manifest without clusters, and there before the first of them.
    let outlines: Vec<&BakeResult> = all.iter().filter(|result| result.kind == outline).collect();
    assert!(outlines.len() == 1 && outlines[0].place < pages[0].place);
    let bytes = client.chunk(output(outlines[0], OUTLINE_OUTPUT).digest, LIMIT_BYTES).unwrap();
    let early = Manifest::from_json(&bytes).unwrap();
    Kinds::new().check(&early).unwrap();
    let (_, whole) = Source::server(client, &bake).manifest().unwrap();
    let mut wanted = whole.clone();
    [CLUSTERS, DIRECTORY, OVERVIEW].iter().for_each(|role| drop(wanted.chunks.remove(*role)));
    wanted.directory.clear();
    wanted.clusters.clear();
    let Body { patches, .. } = whole.body().unwrap();
    wanted.body = serde_json::to_value(Body { patches, ..Body::default() }).unwrap();
    assert_eq!(early, wanted);

    // The pages list all clusters of the manifest, and each chunk is an output of the cell's task.
    let client = ApiClient::new(&server.url, None).unwrap();
    let mut rows = Vec::new();
    for result in &pages {
        let page = client.chunk(output(result, PAGE_OUTPUT).digest, LIMIT_BYTES).unwrap();
        let (of_cell, chunks) = decode_directory(&page).unwrap();
        for chunk in &chunks {
            let is_it = |output: &Artefact| (output.digest, output.bytes) == (chunk.digest, chunk.bytes);
            assert!(result.outputs.iter().any(is_it), "{chunk:?} is none of {result:?}");
        }
        rows.extend(of_cell.into_iter().zip(chunks));
    }
    let whole = whole.clusters.iter().cloned().zip(whole.chunks(CLUSTERS).iter().cloned());
    assert!(!rows.is_empty());
    assert_eq!(sorted(rows), sorted(whole.collect()));
}
