//! How a bake ended as a JUnit report, which CI systems show: a test case for each stage.

use std::fs;
use std::path::Path;
use std::time::Duration;

use lightkiln_proto::api::StageCount;
use quick_xml::events::BytesText;
use quick_xml::writer::Writer;

use crate::commands::following::Ended;
use crate::failure::{Exit, Failure, Result};
use crate::summary::stage_name;

/// A stage, and what became of it.
struct Case {
    name: String,
    secs: f64,
    verdict: Verdict,
}

/// What JUnit knows: passed, or one element with a message.
enum Verdict {
    Passed,
    /// `failure`: the bake is wrong. `error`: it could not be told. `skipped`: the stage never ended.
    Not {
        element: &'static str,
        message: String,
    },
}

/// The report of a bake of `scene`, or of why there is none.
pub fn report(scene: &str, ended: &Result<Ended>, elapsed: Duration) -> String {
    let (id, cases) = match ended {
        Ok(ended) => (Some(ended.bake.id.as_str()), cases(ended, elapsed)),
        Err(failure) => {
            let verdict = Verdict::Not { element: "error", message: failure.to_string() };
            (None, vec![Case { name: "bake".to_owned(), secs: elapsed.as_secs_f64(), verdict }])
        }
    };
    // Writing to memory cannot fail.
    xml(scene, id, &cases, elapsed).unwrap_or_default()
}

/// Writes the report, making its folder if need be.
pub fn write(path: &Path, report: &str) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let made = folder.map_or(Ok(()), fs::create_dir_all);
    made.and_then(|()| fs::write(path, report)).map_err(|error| {
        let what = format!("the report {} cannot be written", path.display());
        Failure::new(Exit::Failed, what).caused_by(&error).try_this("another file with --junit")
    })
}

/// The stages in their order, and the bake as a whole.
fn cases(ended: &Ended, elapsed: Duration) -> Vec<Case> {
    let judged = ended.judge();
    let stages = ended.bake.stages.iter().map(|stage| Case {
        name: stage_name(&stage.kind),
        secs: stage.elapsed_ms as f64 / 1e3,
        verdict: stage_verdict(ended, stage),
    });
    let verdict = match &judged {
        Ok(()) => Verdict::Passed,
        Err(failure) => Verdict::Not { element: "failure", message: failure.message().to_owned() },
    };
    let whole = Case { name: "bake".to_owned(), secs: elapsed.as_secs_f64(), verdict };
    stages.chain([whole]).collect()
}

fn stage_verdict(ended: &Ended, stage: &StageCount) -> Verdict {
    if ended.failed_kind() == Some(stage.kind.as_str()) {
        let message = ended.bake.failure.clone().unwrap_or_else(|| "no reason was given".to_owned());
        return Verdict::Not { element: "failure", message };
    }
    if stage.done == stage.total {
        return Verdict::Passed;
    }
    let message = format!("{} of {} tasks were done when the bake ended", stage.done, stage.total);
    Verdict::Not { element: "skipped", message }
}

fn xml(scene: &str, id: Option<&str>, cases: &[Case], elapsed: Duration) -> std::io::Result<String> {
    let count = |wanted: &str| {
        let is_so =
            |case: &&Case| matches!(&case.verdict, Verdict::Not { element, .. } if *element == wanted);
        cases.iter().filter(is_so).count().to_string()
    };
    let [tests, failures, errors, skipped] =
        [cases.len().to_string(), count("failure"), count("error"), count("skipped")];
    let secs = |secs: f64| format!("{secs:.3}");
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.create_element("testsuites").write_inner_content(|writer| {
        let suite = writer.create_element("testsuite").with_attributes([
            ("name", clean(&format!("kiln {scene}")).as_str()),
            ("tests", &tests),
            ("failures", &failures),
            ("errors", &errors),
            ("skipped", &skipped),
            ("time", &secs(elapsed.as_secs_f64())),
        ]);
        suite.write_inner_content(|writer| {
            for case in cases {
                let name =
                    [("classname", clean(scene)), ("name", case.name.clone()), ("time", secs(case.secs))];
                let name = name.iter().map(|(name, value)| (*name, value.as_str()));
                let element = writer.create_element("testcase").with_attributes(name);
                match &case.verdict {
                    Verdict::Passed => element.write_empty()?,
                    Verdict::Not { element: verdict, message } => element.write_inner_content(|writer| {
                        let first = clean(message.lines().next().unwrap_or_default());
                        let told =
                            writer.create_element(*verdict).with_attribute(("message", first.as_str()));
                        told.write_text_content(BytesText::new(&clean(message))).map(drop)
                    })?,
                };
            }
            if let Some(id) = id {
                let told = format!("bake {}\n", clean(id));
                writer.create_element("system-out").write_text_content(BytesText::new(&told))?;
            }
            Ok(())
        })?;
        Ok(())
    })?;
    let body = String::from_utf8(writer.into_inner()).unwrap_or_default();
    Ok(format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{body}\n"))
}

/// Without the characters that XML 1.0 has no way to write.
fn clean(text: &str) -> String {
    let is_fine = |c: &char| matches!(c, '\t' | '\n' | '\r' | ' '..='\u{d7ff}' | '\u{e000}'..='\u{fffd}' | '\u{10000}'..);
    text.chars().filter(is_fine).collect()
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
        let xml = report("a&b.glb", &Err(failure), Duration::from_millis(1500));
        let elements = elements(&xml);
        let names: Vec<&str> = elements.iter().map(|element| element.0.as_str()).collect();
        assert_eq!(names, ["testsuites", "testsuite", "testcase", "error"]);
        assert_eq!((attribute(&elements[1], "tests"), attribute(&elements[1], "errors")), ("1", "1"));
        assert_eq!(attribute(&elements[1], "time"), "1.500");
        assert_eq!(attribute(&elements[2], "classname"), "a&b.glb");
        assert_eq!(attribute(&elements[3], "message"), "error: a <scene> & \"more\" [31m]]>");
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
