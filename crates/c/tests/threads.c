// A completer, a scene and a completion used by eight threads at once: the same bits as with one thread, errors per thread,
// handles freed concurrently, and a fork.

#define _POSIX_C_SOURCE 200809L

#include "check.h"
#include <pthread.h>
#include <sys/wait.h>
#include <unistd.h>

enum { THREADS = 8, ROUNDS = 6, COUNT = 100 };

static uint8_t images[2][3 * PIXELS];
static double xs[COUNT], ys[COUNT];
static float depths[COUNT];
static lsdc_completer *completer;
static lsdc_scene *scene;
static lsdc_completion *completion;

struct results {
    float depth[PIXELS], deviation[PIXELS];
    double leave_one_out[COUNT];
};
static struct results expected[2];

static void read_results(const lsdc_completion *from, struct results *results) {
    OK(lsdc_completion_depth(from, WIDTH, HEIGHT, results->depth, sizeof results->depth, 0));
    OK(lsdc_completion_standard_deviation(from, WIDTH, HEIGHT, results->deviation, sizeof results->deviation, 0));
    OK(lsdc_completion_leave_one_out(from, results->leave_one_out, COUNT));
}

static void check_results(const lsdc_completion *from, int which) {
    struct results results;
    read_results(from, &results);
    CHECK(memcmp(&results, &expected[which], sizeof results) == 0);
}

static lsdc_completion *completed(int which) {
    lsdc_image image = image_of(images[which], WIDTH, HEIGHT);
    lsdc_points points = points_of(xs, ys, depths, COUNT);
    lsdc_scene *own;
    lsdc_completion *made;
    OK(lsdc_scene_create(completer, &image, NULL, &own));
    OK(lsdc_scene_complete(own, &points, NULL, &made));
    OK(lsdc_scene_free(own));
    return made;
}

static void *work(void *argument) {
    int number = *(const int *)argument;
    char name[16], message[64];
    snprintf(name, sizeof name, "thread-%d", number);
    snprintf(message, sizeof message, "there are no weights named `%s`", name);
    lsdc_completer *none;
    CHECK(strcmp(lsdc_last_error(), "") == 0);
    CHECK(lsdc_completer_create(name, NULL, &none) == LSDC_ERROR_WEIGHTS);
    for (int i = 0; i < ROUNDS; ++i) {
        int which = (number + i) % 2;
        lsdc_completion *own = completed(which);
        check_results(own, which);
        OK(lsdc_completion_free(own));
        // A new completion of the shared scene, and the shared completion, whose results are computed on request and cached.
        lsdc_points points = points_of(xs, ys, depths, COUNT);
        OK(lsdc_scene_complete(scene, &points, NULL, &own));
        check_results(own, 0);
        OK(lsdc_completion_free(own));
        check_results(completion, 0);
        CHECK(strcmp(lsdc_last_error(), message) == 0);
    }
    return NULL;
}

// Handles that every thread uses and frees: one thread succeeds, the others get an error.
static lsdc_completion *shared[ROUNDS];
static int freed[THREADS];

static void *compete(void *argument) {
    int number = *(const int *)argument;
    static float buffers[THREADS][PIXELS];
    for (int i = 0; i < ROUNDS; ++i) {
        lsdc_status status =
            lsdc_completion_depth(shared[i], WIDTH, HEIGHT, buffers[number], sizeof buffers[number], 0);
        CHECK(status == LSDC_OK || status == LSDC_ERROR_HANDLE);
        status = lsdc_completion_free(shared[i]);
        CHECK(status == LSDC_OK || status == LSDC_ERROR_HANDLE);
        freed[number] += status == LSDC_OK;
    }
    return NULL;
}

// A child process has no threads of its parent, and can start its own.
static void fork_away(lsdc_completer_options options) {
    pid_t child = fork();
    CHECK(child >= 0);
    if (child == 0) {
        static float depth[PIXELS];
        lsdc_completion *none;
        lsdc_points points = points_of(xs, ys, depths, COUNT);
        FAILS(LSDC_ERROR_HANDLE, "fork()", lsdc_scene_complete(scene, &points, NULL, &none));
        FAILS(LSDC_ERROR_HANDLE, "fork()", lsdc_completion_depth(completion, WIDTH, HEIGHT, depth, sizeof depth, 0));
        OK(lsdc_completer_create("small", &options, &completer));
        check_results(completed(1), 1);
        _exit(EXIT_SUCCESS);
    }
    int status;
    CHECK(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == EXIT_SUCCESS);
}

static void together(void *(*job)(void *)) {
    pthread_t threads[THREADS];
    int numbers[THREADS];
    for (int i = 0; i < THREADS; ++i) {
        numbers[i] = i;
        CHECK(pthread_create(&threads[i], NULL, job, &numbers[i]) == 0);
    }
    for (int i = 0; i < THREADS; ++i) CHECK(pthread_join(threads[i], NULL) == 0);
}

int main(void) {
    uint64_t random = 3;
    paint(images[0], WIDTH, HEIGHT, 7);
    paint(images[1], WIDTH, HEIGHT, 8);
    for (int i = 0; i < COUNT; ++i) {
        xs[i] = uniform(&random) * (WIDTH - 1);
        ys[i] = uniform(&random) * (HEIGHT - 1);
        depths[i] = (float)(2.0 + xs[i] / WIDTH + 0.1 * uniform(&random));
    }
    // The results with one thread.
    lsdc_completer_options options = quick();
    options.threads = 1;
    OK(lsdc_completer_create("small", &options, &completer));
    for (int which = 0; which < 2; ++which) {
        completion = completed(which);
        read_results(completion, &expected[which]);
        OK(lsdc_completion_free(completion));
    }
    OK(lsdc_completer_free(completer));

    const size_t pools[] = {0, 1, 3};
    for (int i = 0; i < 3; ++i) {
        options.threads = pools[i];
        lsdc_image image = image_of(images[0], WIDTH, HEIGHT);
        lsdc_points points = points_of(xs, ys, depths, COUNT);
        OK(lsdc_completer_create("small", &options, &completer));
        OK(lsdc_scene_create(completer, &image, NULL, &scene));
        OK(lsdc_scene_complete(scene, &points, NULL, &completion));
        together(work);
        for (int k = 0; k < ROUNDS; ++k) shared[k] = completed(k % 2);
        memset(freed, 0, sizeof freed);
        together(compete);
        int all = 0;
        for (int k = 0; k < THREADS; ++k) all += freed[k];
        CHECK(all == ROUNDS);
        fork_away(options);
        OK(lsdc_completion_free(completion));
        OK(lsdc_scene_free(scene));
        OK(lsdc_completer_free(completer));
    }
    puts("threads: the same bits");
    return EXIT_SUCCESS;
}
