//! How a bake ended as a JUnit report, which CI systems show: a test case for each stage.

use std::fs;
use std::path::Path;
use std::time::Duration;

use lightkiln_proto::api::StageCount;
use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use crate::failure::{Exit, Failure};
use crate::following::Ended;
use crate::outputs;
use crate::summary::stage_name;

/// The report of a bake of `scene`, or of why there is none; `evaluated` says whether its evaluation met its limits, if
/// there was one.
pub fn report(
    scene: &str,
    ended: Result<&Ended, &Failure>,
    evaluated: Option<&Result<(), Failure>>,
    elapsed: Duration,
) -> String {
    let mut suite = TestSuite::new(format!("kiln {scene}"));
    suite.set_time(elapsed);
    let mut add = |name: &str, time: Duration, status: TestCaseStatus| {
        let mut case = TestCase::new(name, status);
        case.set_classname(scene).set_time(time);
        suite.add_test_case(case);
    };
    match ended {
        Ok(ended) => {
            for stage in &ended.bake.stages {
                let elapsed = Duration::from_millis(stage.elapsed_ms);
                add(&stage_name(&stage.kind), elapsed, stage_status(ended, stage));
            }
            let failed = |failure: Failure| told(NonSuccessKind::Failure, failure.message());
            add("bake", elapsed, ended.judge().err().map_or_else(TestCaseStatus::success, failed));
            if let Some(evaluated) = evaluated {
                let status = evaluated.as_ref().err().map_or_else(TestCaseStatus::success, not_met);
                add("evaluation", elapsed, status);
            }
            suite.set_system_out(format!("bake {}\n", ended.bake.id));
        }
        // Nobody can tell how the bake ended.
        Err(failure) => add("bake", elapsed, told(NonSuccessKind::Error, &failure.to_string())),
    }
    let mut report = Report::unnamed();
    report.add_test_suite(suite);
    // Writing to memory cannot fail.
    report.to_string().unwrap_or_default()
}

/// Refuses a place where the report could not be written.
pub fn check(path: &Path) -> Result<(), Failure> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.map_or(Ok(()), outputs::check_folder)
}

/// Writes the report, making its folder if need be.
pub fn write(path: &Path, report: &str) -> Result<(), Failure> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let made = folder.map_or(Ok(()), fs::create_dir_all);
    made.and_then(|()| fs::write(path, report)).map_err(|error| {
        let what = format!("the report {} cannot be written", path.display());
        Failure::new(Exit::Failed, what).caused_by(&error).try_this("another file with --junit")
    })
}

fn stage_status(ended: &Ended, stage: &StageCount) -> TestCaseStatus {
    if ended.failed_kind() == Some(stage.kind.as_str()) {
        let message = ended.bake.failure.as_deref().unwrap_or("no reason was given");
        return told(NonSuccessKind::Failure, message);
    }
    if stage.done == stage.total {
        return TestCaseStatus::success();
    }
    let mut status = TestCaseStatus::skipped();
    status.set_message(format!("{} of {} tasks were done when the bake ended", stage.done, stage.total));
    status
}

/// An evaluation that breaks a limit, or that could not be made.
fn not_met(failure: &Failure) -> TestCaseStatus {
    match failure.exit() {
        Exit::LimitBroken => told(NonSuccessKind::Failure, failure.message()),
        _ => told(NonSuccessKind::Error, &failure.to_string()),
    }
}

/// A case that is no success: the first line as its message, the whole as its text.
fn told(kind: NonSuccessKind, message: &str) -> TestCaseStatus {
    let mut status = TestCaseStatus::non_success(kind);
    status.set_message(message.lines().next().unwrap_or_default()).set_description(message);
    status
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Element names with their attributes, in order; panics where the text is no XML.
    fn elements(xml: &str) -> Vec<(String, Vec<(String, String)>)> {
        use quick_xml::events::Event;
        let mut reader = quick_xml::Reader::from_str(xml);
        reader.config_mut().check_end_names = true;
        let mut found = Vec::new();
        loop {
            match reader.read_event().unwrap() {
                Event::Start(start) | Event::Empty(start) => {
                    let attributes = start.attributes().map(|attribute| {
                        let attribute = attribute.unwrap();
                        let value = String::from_utf8(attribute.value.to_vec()).unwrap();
                        let value = quick_xml::escape::unescape(&value).unwrap().into_owned();
                        (String::from_utf8(attribute.key.as_ref().to_vec()).unwrap(), value)
                    });
                    found.push((
                        String::from_utf8(start.name().as_ref().to_vec()).unwrap(),
                        attributes.collect(),
                    ));
                }
                Event::Eof => return found,
                _ => (),
            }
        }
    }

    fn attribute<'a>(element: &'a (String, Vec<(String, String)>), name: &str) -> &'a str {
        &element.1.iter().find(|(known, _)| known == name).unwrap().1
    }

    #[test]
    fn bake_that_never_began_is_an_error_in_the_report_whatever_its_words_are() {
        let failure = Failure::bad_input("a <scene> & \"more\"\u{0} \u{1b}[31m]]>").try_this("another");
        let xml = report("a&b.glb", Err(&failure), None, Duration::from_millis(1500));
        let elements = elements(&xml);
        let names: Vec<&str> = elements.iter().map(|element| element.0.as_str()).collect();
        assert_eq!(names, ["testsuites", "testsuite", "testcase", "error"]);
        assert_eq!((attribute(&elements[1], "tests"), attribute(&elements[1], "errors")), ("1", "1"));
        assert_eq!(attribute(&elements[1], "time"), "1.500");
        assert_eq!(attribute(&elements[2], "classname"), "a&b.glb");
        assert_eq!(attribute(&elements[3], "message"), "error: a <scene> & \"more\" ]]>");
        assert!(!xml.contains('\u{0}') && !xml.contains('\u{1b}'));
    }

    #[test]
    fn report_goes_into_a_folder_that_is_made_for_it() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("a/b/junit.xml"), "<testsuites/>").unwrap();
        assert!(folder.path().join("a/b/junit.xml").is_file());
        let refused = write(folder.path(), "<testsuites/>").unwrap_err();
        assert!(refused.to_string().contains("--junit"), "{refused}");
    }
}
