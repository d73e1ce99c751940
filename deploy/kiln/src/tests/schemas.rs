//! Files of other programs, held against those programs' own schemas.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::{documents, names_in, text_of};

/// A program of the folder that `tests/run` names.
fn checker(name: &str) -> Command {
    let folder =
        std::env::var_os("KILN_TEST_SCHEMAS").expect("KILN_TEST_SCHEMAS is the folder of check-jsonschema");
    Command::new(PathBuf::from(folder).join(name))
}

/// Panics unless the check takes a file's text, and refuses it with `wrong` in the place of `right`.
fn assert_checked(path: &str, (right, wrong): (&str, &str), check: impl Fn(&Path) -> Output) {
    let text = text_of(path);
    assert!(text.contains(right), "{path} has no {right}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(Path::new(path).file_name().unwrap());
    for (text, is_good) in [(text.clone(), true), (text.replacen(right, wrong, 1), false)] {
        std::fs::write(&file, text).unwrap();
        let told = check(&file);
        assert_eq!(told.status.success(), is_good, "{path}, {wrong} for {right}: {}", words(&told));
    }
}

fn words(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned()).concat()
}

#[test]
#[ignore = "needs check-jsonschema, which tests/run installs"]
fn schemas_of_compose_github_and_gitlab_take_our_files() {
    for (path, schema, fault) in [
        ("deploy/compose.yaml", "compose-spec", ("depends_on:", "depend_on:")),
        ("deploy/ci/github.yml", "github-workflows", ("runs-on:", "runs-in:")),
        ("deploy/ci/gitlab.yml", "gitlab-ci", ("when: always", "when: ever")),
    ] {
        assert_checked(path, fault, |file| {
            let schema = format!("vendor.{schema}");
            checker("check-jsonschema").args(["--builtin-schema", &schema]).arg(file).output().unwrap()
        });
    }
}

#[test]
#[ignore = "needs kubernetes-validate, which tests/run installs"]
fn schemas_of_kubernetes_take_our_manifests() {
    let faults = [
        ("ingress.yaml", ("pathType:", "pathKind:")),
        ("namespace.yaml", ("labels:", "label:")),
        ("network.yaml", ("podSelector:", "podsSelector:")),
        ("server.yaml", ("readinessProbe:", "readyProbe:")),
        ("token-job.yaml", ("backoffLimit: 0", "backoffLimit: none")),
        ("worker.yaml", ("terminationGracePeriodSeconds: 60", "terminationGracePeriodSeconds: long")),
    ];
    for (file, fault) in faults {
        assert_checked(&format!("deploy/kubernetes/{file}"), fault, |file| {
            // The checker asks for a name, which a job may get from the cluster.
            let text = std::fs::read_to_string(file).unwrap().replace("generateName: token-", "name: token");
            std::fs::write(file, text).unwrap();
            // Strictly: a setting that Kubernetes does not know is an error.
            checker("kubernetes-validate").arg("--strict").arg(file).output().unwrap()
        });
    }
    // Kinds of others than Kubernetes.
    let of_others = ["Kustomization", "ScaledObject", "PodMonitor"];
    let unchecked = names_in("deploy/kubernetes", ".yaml").into_iter().filter(|file| {
        let objects = documents(&format!("deploy/kubernetes/{file}"));
        let is_ours = |kind: &str| !of_others.contains(&kind);
        objects.iter().any(|object| is_ours(object["kind"].as_str().unwrap()))
            && faults.iter().all(|(known, _)| known != file)
    });
    assert_eq!(unchecked.collect::<Vec<_>>(), [""; 0], "manifests that nothing checks");
}
