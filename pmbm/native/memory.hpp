// Columns that outlive the call that made them: what is large returns to the system as soon as it is
// done with.  In the heap, holes of their size would stay between what is short-lived.
#pragma once

#include <cstddef>
#include <new>
#include <vector>

#if defined(__unix__) || defined(__APPLE__)
#include <sys/mman.h>
#if defined(__GLIBC__)
#include <malloc.h>
#endif
#define PMBM_PAGES 1
#endif

namespace pmbm {

// Rows beyond which memory is worth the time that giving it back takes.
constexpr std::size_t kMany = 1 << 16;

// Returns what the heap keeps for later, where there is a call for it.
inline void trim_heap() {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
}

template <typename T>
struct Pages {
    using value_type = T;

    Pages() = default;
    template <typename U>
    Pages(const Pages<U>&) noexcept {}

    static bool has_its_own(std::size_t count) {
#ifdef PMBM_PAGES
        return count * sizeof(T) >= std::size_t{1} << 20;
#else
        return false;
#endif
    }

    T* allocate(std::size_t count) {
        const auto bytes = count * sizeof(T);
#ifdef PMBM_PAGES
        if (has_its_own(count)) {
            void* made = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS,
                              -1, 0);
            if (made == MAP_FAILED) throw std::bad_alloc();
            return static_cast<T*>(made);
        }
#endif
        return static_cast<T*>(::operator new(bytes));
    }

    void deallocate(T* memory, std::size_t count) noexcept {
#ifdef PMBM_PAGES
        if (has_its_own(count)) {
            munmap(memory, count * sizeof(T));
            return;
        }
#endif
        ::operator delete(memory);
    }

    template <typename U>
    bool operator==(const Pages<U>&) const noexcept {
        return true;
    }
    template <typename U>
    bool operator!=(const Pages<U>&) const noexcept {
        return false;
    }
};

template <typename T>
using Column = std::vector<T, Pages<T>>;

}  // namespace pmbm
