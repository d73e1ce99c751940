//! Rules of all stores of the farm: one suite, run over each of them.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod alarms;
mod bakes;
mod batch;
mod bearers;
mod checks;
mod chunks;
#[path = "../clock/mod.rs"]
mod clock;
mod crash;
mod durability;
mod evaluations;
mod failure;
mod graph;
mod hints;
mod history;
mod leases;
mod limits;
mod locks;
mod migration;
#[path = "../model/mod.rs"]
mod model;
#[path = "../parts/mod.rs"]
mod parts;
mod remaking;
mod replicas;
mod reruns;
mod results;
mod reuse;
mod scheduling;
mod support;
mod universe;
mod views;

/// Runs every test over every store. A test that is not named here is dead code, and the compiler says so.
macro_rules! conformance {
    ($($module:ident: $($test:ident)+;)+) => {
        mod memory {
            use crate::support::{World, in_time};

            $($(#[tokio::test] async fn $test() { in_time(crate::$module::$test(World::memory().await)).await; })+)+
        }
        mod sqlite {
            use crate::support::{World, in_time};

            $($(#[tokio::test] async fn $test() { in_time(crate::$module::$test(World::sqlite().await)).await; })+)+
        }
        mod postgres {
            use crate::support::{World, in_time};

            $($(#[tokio::test] async fn $test() { in_time(crate::$module::$test(World::postgres().await)).await; })+)+
        }
    };
}

conformance! {
    alarms:
        result_that_is_handed_in_again_with_other_outputs_is_an_alarm
        token_that_comes_twice_at_once_with_other_outputs_is_an_alarm_and_the_first_counts
        late_result_with_other_outputs_is_an_alarm_whichever_came_first
        bake_is_told_of_the_first_alarms_and_counts_all
        leases_that_ran_out_and_were_not_begun_are_remembered_up_to_a_number
        late_result_with_the_same_outputs_is_none
        result_that_is_made_anew_with_other_outputs_is_an_alarm;
    bakes:
        same_key_and_body_give_the_same_bake
        same_key_with_another_body_is_refused
        without_a_key_every_submission_is_a_bake
        paused_bake_holds_its_tasks_back_until_resumed
        cancelled_bake_tells_holders_to_stop_and_refuses_their_results
        cancel_keeps_what_another_bake_wants
        cancel_again_changes_nothing
        ended_bake_refuses_changes
        priority_then_share_then_age_then_cost_then_key_decide_the_order
        task_is_claimed_right_after_the_costlier_one_that_it_waited_for
        changed_priority_changes_the_order
        unknown_bake_is_an_error;
    bearers:
        bearers_are_listed_by_name_also_when_revoked
        name_of_a_bearer_is_given_once
        revoking_again_changes_nothing;
    chunks:
        first_of_equal_bytes_is_kept
        replaced_bytes_are_condemned
        chunk_that_nobody_needs_goes_after_the_grace
        what_a_bake_needs_stays_until_it_is_deleted
        result_of_two_bakes_stays_until_both_are_deleted
        live_bake_cannot_be_deleted
        old_bakes_are_deleted_when_they_are_not_to_be_kept
        result_whose_output_went_is_refused_until_it_is_stored_again
        bake_without_its_scene_or_artefacts_is_refused
        lost_chunk_makes_its_task_run_again
        lost_scene_can_be_uploaded_again
        quota_refuses_what_would_exceed_it
        orphans_are_condemned_and_others_are_not
        equal_bytes_are_stored_once_and_removed_when_nobody_needs_them
        late_removal_does_not_meet_what_was_stored_meanwhile
        uploads_beside_collections_lose_nothing
        damaged_bytes_are_given_up_when_they_are_read
        chunk_that_was_stored_again_meanwhile_is_not_lost
        upload_beyond_the_quota_leaves_nothing_and_works_when_there_is_room
        bytes_from_before_generations_are_found;
    checks:
        check_finds_what_is_wrong_and_makes_it_good
        scene_is_lost_only_while_a_live_bake_needs_it
        artefact_that_an_ended_bake_names_is_made_again_by_the_next
        ended_bake_says_what_it_lost_also_when_a_live_one_gives_up;
    evaluations:
        evaluation_holds_its_files_until_it_is_replaced_or_its_bake_deleted
        evaluation_is_refused_unless_the_bake_is_done_and_its_files_are_kept;
    graph:
        dependants_start_only_after_commit
        lease_carries_the_outputs_of_dependencies
        plan_of_a_result_is_added_once
        plan_may_depend_on_its_own_planner
        plan_with_an_unknown_dependency_changes_nothing
        plan_with_a_cycle_changes_nothing
        one_key_for_two_tasks_is_refused
        plan_cannot_take_the_key_of_a_task_that_is_not_there_yet
        bake_is_done_when_all_tasks_are
        bake_without_tasks_is_done_at_once
        thousand_tasks_behind_one_are_unlocked_together;
    leases:
        claimed_task_is_not_handed_out_again
        lease_names_the_trace_of_its_bake
        claims_respect_kind_and_number
        heartbeat_prolongs_the_lease
        expired_lease_is_refused_before_and_after_the_reaper
        lost_lease_requeues_task_once
        same_token_commits_once
        results_that_come_together_are_each_taken_in_or_refused
        released_task_is_ready_and_costs_no_attempt
        release_and_fail_of_a_lost_lease_change_nothing
        unknown_token_is_lost_and_stale
        concurrent_claims_hand_every_task_out_once
        lease_of_a_clock_that_was_set_back_lasts_no_longer_than_its_length
        wait_of_a_clock_that_was_set_back_is_over
        limit_of_a_clock_that_was_set_back_is_kept
        worker_seen_by_a_clock_that_was_set_back_is_not_there_for_ever;
    limits:
        bake_at_its_limit_of_workers_goes_to_those_that_hold_some_of_it
        bake_at_its_limit_of_workers_holds_no_other_back
        look_tells_who_may_take_tasks_of_a_bake_with_a_limit
        demand_of_a_bake_with_a_limit_is_its_free_places
        concurrent_claims_keep_to_the_limit_of_workers
        attempts_of_a_bake_count_alone
        lost_workers_of_a_bake_count_instead_of_the_farms
        leases_of_a_lost_worker_that_were_not_begun_count_no_attempt
        most_generous_bake_decides_about_a_task_of_several;
    failure:
        task_fault_fails_every_bake_that_wants_it
        worker_fault_is_retried_by_another_worker_after_a_wait
        only_worker_may_try_its_task_again
        task_goes_back_when_all_others_failed_at_it_too
        third_worker_that_fails_makes_it_poison
        attempts_are_limited
        twenty_five_lost_workers_fail_no_bake
        task_that_is_always_lost_fails_its_bake_by_that_word
        lost_workers_and_failures_are_counted_apart
        leases_that_nobody_was_heard_about_count_no_attempt
        attempt_of_a_worker_that_was_silent_and_is_alive_is_given_back
        failure_that_is_reported_late_still_counts
        attempt_keeps_its_number_when_an_earlier_one_is_given_back
        failed_bake_drops_its_other_tasks
        failed_task_gets_another_chance_in_a_new_bake;
    scheduling:
        bakes_of_one_priority_share_the_workers
        worker_keeps_to_the_scene_that_it_has
        bakes_wait_for_workers_that_have_what_they_need
        task_is_not_left_to_a_worker_that_cannot_do_it
        worker_that_fails_again_and_again_is_blocked_until_it_is_cleared
        attempt_that_takes_too_long_is_ended_although_its_worker_is_heard
        bake_that_always_takes_too_long_says_so
        leases_run_on_after_the_farm_could_not_hear_anybody
        lease_is_extended_so_often_until_its_worker_is_heard_again
        hundred_bakes_are_all_served;
    reuse:
        done_task_is_not_run_again_and_its_plan_is_followed
        bake_of_done_tasks_is_done_at_once
        two_bakes_share_one_run
        lease_tells_of_the_newest_results_of_tasks_that_have_its_name_in_common
        note_of_a_result_is_told_by_the_event_of_its_end
        bake_that_joins_late_sees_the_lease
        forgotten_result_is_run_again
        forgotten_result_makes_dependants_wait
        reusable_follows_plans;
    remaking:
        readers_of_a_lost_artefact_wait_until_it_is_made_again
        attempt_that_lost_its_input_counts_for_nobody_also_after_it_is_made_again
        reader_that_runs_again_waits_too
        reader_that_makes_the_same_bytes_does_not_wait_for_itself
        bake_does_not_wait_for_what_only_another_one_makes
        artefact_that_is_made_otherwise_fails_the_bake_and_says_so
        artefact_that_nobody_reads_may_be_made_otherwise
        results_say_what_their_plans_still_need;
    reruns:
        result_is_made_once_more_on_another_machine
        worker_without_a_machine_verifies_what_another_worker_gave
        result_that_comes_out_otherwise_is_one_alarm_and_the_first_stays
        tasks_that_are_ready_come_before_results_to_verify
        share_chooses_by_the_key_alone
        biggest_share_of_the_bakes_that_want_a_task_counts
        result_is_verified_by_a_worker_that_can_do_its_task
        look_tells_of_results_by_who_may_verify_them
        result_that_nobody_verifies_in_time_lapses
        wait_of_a_result_under_a_clock_that_was_set_back_is_no_longer
        failed_and_vanished_attempts_to_verify_count_for_no_bake_and_lapse_at_the_last_try
        vanished_attempt_to_verify_is_the_last_like_any_other
        attempt_to_verify_that_is_given_back_is_no_try
        attempts_to_verify_run_on_after_the_farm_could_not_hear_anybody
        result_whose_inputs_are_lost_is_not_verified
        result_that_is_forgotten_or_deleted_is_not_verified
        rerun_that_a_live_bake_lost_is_chosen_anew
        results_of_a_paused_or_cancelled_bake_are_not_verified
        result_that_lands_while_its_bake_is_paused_waits_for_its_end
        results_of_a_bake_that_is_done_while_it_is_paused_are_verified
        concurrent_claims_make_each_result_once_more;
    results:
        results_come_in_the_order_in_which_they_landed
        results_of_one_kind_are_told_alone
        page_of_results_ends_where_it_is_full
        page_of_results_tells_where_the_next_begins
        reused_results_land_with_the_plan_that_asks_for_them
        result_that_lands_again_comes_behind_all_others
        result_that_an_ended_bake_lost_lands_again;
    hints:
        waiting_claim_gets_what_is_submitted_later
        waiting_claim_needs_no_hint
        workers_without_hints_finish_a_bake
        waiting_for_events_ends_with_one
        waiting_for_results_ends_with_one_of_the_kind_asked_for
        results_whose_bytes_are_gone_are_run_again
        plans_whose_bytes_are_gone_are_made_again
        result_without_its_bytes_is_refused;
    views:
        events_have_no_gaps_and_tell_the_story
        events_tell_what_became_of_each_attempt
        events_page_through
        list_pages_newest_first
        list_goes_on_behind_a_bake_that_was_deleted
        list_holds_what_the_filter_takes
        filtered_list_pages_without_a_gap
        bakes_are_found_by_the_beginning_of_their_ids
        stages_count_what_happens
        results_are_named_when_done
        workers_show_what_they_hold
        stats_count_tasks_by_state
        stats_tell_for_how_long_tasks_have_been_waiting
        counts_of_run_and_reused_tasks_never_fall
        probe_writes;
}
