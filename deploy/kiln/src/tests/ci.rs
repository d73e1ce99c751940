//! The templates for CI systems, and the page beside them.

use serde_json::Value;

use super::{documents, text_of, texts};
use crate::failure::EXIT_CODES;

fn github() -> Value {
    documents("deploy/ci/github.yml").remove(0)
}

fn gitlab() -> Value {
    documents("deploy/ci/gitlab.yml").remove(0)
}

/// Lines of shell that the templates run, with the template's name.
pub fn scripts() -> Vec<(&'static str, String)> {
    let github = github();
    let steps = github["jobs"]["bake"]["steps"].as_array().unwrap().iter();
    let runs = steps.filter_map(|step| step["run"].as_str());
    let mut scripts: Vec<_> = runs.map(|run| ("deploy/ci/github.yml", run.to_owned())).collect();
    let gitlab = gitlab();
    scripts.extend(
        texts(&gitlab["bake"]["script"]).into_iter().map(|run| ("deploy/ci/gitlab.yml", run.to_owned())),
    );
    assert_eq!(scripts.len(), 6, "{scripts:#?}");
    scripts
}

#[test]
fn templates_run_the_same_commands() {
    let scripts = scripts();
    let of = |wanted: &str| {
        let of = scripts.iter().filter(|(template, _)| template.ends_with(wanted));
        of.map(|(_, run)| run.trim().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(of("github.yml"), of("gitlab.yml"));
    let submit = &of("gitlab.yml")[0];
    for flag in ["--wait", "--json", "--junit out/junit.xml"] {
        assert!(submit.contains(flag), "{submit}");
    }
}

#[test]
fn github_job_has_few_rights_an_end_and_its_secrets_from_outside() {
    let github = github();
    assert_eq!(github["permissions"], serde_json::json!({"contents": "read"}));
    let job = &github["jobs"]["bake"];
    assert!(job["timeout-minutes"].is_u64());
    assert_eq!(job["env"]["KILN_TOKEN"], "${{ secrets.KILN_TOKEN }}");
    assert_eq!(job["env"]["KILN_COMMIT"], "${{ github.sha }}");
    let steps = job["steps"].as_array().unwrap();
    for step in steps {
        // Text from outside reaches a shell as a variable, never as its code.
        assert!(step["run"].as_str().is_none_or(|run| !run.contains("${{")), "{step}");
        let uses = step["uses"].as_str();
        assert!(uses.is_none_or(|uses| uses.starts_with("actions/") && uses.contains("@v")), "{step}");
    }
    let kept = steps.last().unwrap();
    assert_eq!((&kept["if"], &kept["with"]["path"]), (&"always()".into(), &"out".into()));
}

#[test]
fn gitlab_job_keeps_its_report_whatever_became_of_the_bake() {
    let job = gitlab()["bake"].clone();
    assert_eq!(job["artifacts"]["when"], "always");
    assert_eq!(job["artifacts"]["reports"]["junit"], "out/junit.xml");
    assert_eq!(job["variables"]["KILN_COMMIT"], "$CI_COMMIT_SHA");
    assert!(job["variables"].get("KILN_TOKEN").is_none(), "a secret is no part of the file");
    assert!(job["timeout"].is_string());
}

#[test]
fn page_has_every_problem_with_its_status() {
    use lightkiln_proto::problem::ProblemCode;
    let page = text_of("deploy/README.md");
    for code in ProblemCode::ALL {
        let uri = code.type_uri();
        let row = format!("| `{}` | {} |", uri.rsplit(':').next().unwrap(), code.row().0);
        assert!(page.contains(&row), "the page has no row {row}");
    }
}

#[test]
fn page_has_the_exit_codes_of_the_program() {
    let page = text_of("deploy/ci/README.md");
    let codes: Vec<(&str, &str)> =
        EXIT_CODES.lines().skip(1).filter_map(|line| line.trim().split_once(' ')).collect();
    assert_eq!(codes.len(), 7);
    for (code, what) in codes {
        let row = format!("| {code} | {} |", what.trim());
        assert!(page.contains(&row), "the page has no row {row}");
    }
}
