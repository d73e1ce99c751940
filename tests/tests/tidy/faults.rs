//! The faults that `tests/studies/wrong-builds` makes on purpose.

use std::process::Command;

use super::root;

#[test]
fn every_fault_of_the_wrong_builds_still_changes_the_source() {
    let check = Command::new("tests/studies/wrong-builds").arg("check").current_dir(root()).output();
    let output = check.expect("the script can be run (bash and perl)");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
