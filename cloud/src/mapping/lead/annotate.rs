//! Annotate. The leader's answers to requests for places and zones.

use std::sync::Arc;

use zenav_protocol::bus::Request;
use zenav_protocol::messages::{AnnotateAction, AnnotateRequest, Annotations, Refusal};
use zenav_protocol::time::Stamp;

use super::Leadership;

impl Leadership {
    /// Answers a request for the annotations; a change is carried out once, under the lease in force.
    pub(super) async fn annotate(&mut self, request: Request<AnnotateRequest, Annotations>, now: Stamp) {
        let AnnotateRequest {
            action,
            request_id,
            epoch,
        } = request.body.clone();
        if action == AnnotateAction::Get {
            request.reply(self.annotations.now());
            return;
        }
        let answer = match self.annotated.get(request_id.as_deref()) {
            Some(first) => first,
            None => match self.authority.admit(now, epoch) {
                Err(refusal) => Err(refusal),
                Ok(()) if self.is_locked_out => Err(Refusal::rejected(
                    "places and zones cannot be stored: the mapping service that led before is suspended and locks the folder; end it, and \
                     restart this one",
                )),
                Ok(()) => {
                    // A successor of this process would carry a change over again if it continued in an older frame.
                    if self.session.frame() != self.core.mapper.map().frame {
                        let _ = self.keep(now, true).await;
                    }
                    let changed = self.annotations.change(action).await;
                    if changed == Ok(true) {
                        self.outbox.annotations.put(self.annotations.now());
                    }
                    let answer = changed.map(|_| Arc::new(self.annotations.now().clone()));
                    self.annotated.keep(request_id, &answer);
                    answer
                }
            },
        };
        match answer {
            Ok(annotations) => request.reply(&annotations),
            Err(refusal) => request.refuse(&refusal),
        }
    }
}
