// The functions of fastdds_shim.cpp in a process of its own: questions on stdin, answers on stdout.
//
// Both are strings of bytes: how many there are, then each after its size; numbers are 32 bits of
// this machine. Questions are `new NAME VALUE...`, `delete PARTICIPANT` and `call PARTICIPANT
// FUNCTION NUMBER FIRST SECOND`.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

extern "C" {

struct Answer {
    std::int32_t code;
    std::size_t handle;
    const char* words;
    std::size_t words_size;
    const char* data;
    std::size_t size;
};

void* fastdds_new(const char* const* pairs, std::size_t count) noexcept;
void fastdds_delete(void* participant) noexcept;
void fastdds_call(
        void* participant, Answer* answer, const char* function, std::size_t number,
        const char* first, std::size_t first_size, const char* second,
        std::size_t second_size) noexcept;

}

namespace {

using Strings = std::vector<std::string>;

void read_exactly(char* data, std::size_t size) {
    if (std::fread(data, 1, size, stdin) != size) {
        std::exit(0);  // the test is over
    }
}

std::uint32_t read_number() {
    std::uint32_t number = 0;
    read_exactly(reinterpret_cast<char*>(&number), sizeof number);
    return number;
}

Strings read_question() {
    Strings strings(read_number());
    for (std::string& each : strings) {
        each.resize(read_number());
        read_exactly(each.data(), each.size());
    }
    return strings;
}

void write_number(std::size_t value) {
    const auto number = static_cast<std::uint32_t>(value);
    std::fwrite(&number, sizeof number, 1, stdout);
}

void write_answer(const Strings& strings) {
    write_number(strings.size());
    for (const std::string& each : strings) {
        write_number(each.size());
        std::fwrite(each.data(), 1, each.size(), stdout);
    }
    std::fflush(stdout);
}

std::vector<void*> participants;

Strings answer_to(const Strings& question) {
    if (question.at(0) == "new") {
        std::vector<const char*> pairs;
        for (std::size_t at = 1; at < question.size(); at++) {
            pairs.push_back(question[at].c_str());
        }
        void* made = fastdds_new(pairs.data(), pairs.size());
        if (made == nullptr) {
            return {};
        }
        participants.push_back(made);
        return {std::to_string(participants.size() - 1)};
    }
    void* participant = participants.at(std::stoul(question.at(1)));
    if (question[0] == "delete") {
        fastdds_delete(participant);
        return {};
    }
    const std::string &first = question.at(4), &second = question.at(5);
    Answer answer;
    fastdds_call(
        participant, &answer, question.at(2).c_str(), std::stoul(question.at(3)), first.data(),
        first.size(), second.data(), second.size());
    return {std::to_string(answer.code), std::to_string(answer.handle),
            {answer.words, answer.words_size}, {answer.data, answer.size}};
}

}  // namespace

int main() {
    for (;;) {
        write_answer(answer_to(read_question()));
    }
}
